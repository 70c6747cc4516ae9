/** Skeletons and forward kinematics, equal to moveset.motion.kinematics.fk to float precision. */

/** A skeleton as moveset's server and files tell it. */
export interface SkeletonData {
  name: string;
  joints: string[];
  /** Index of each joint's parent; -1 for the root, which comes first. */
  parents: number[];
  /** (J, 3) position relative to the parent in the rest pose, metres; at rest every rotation is the identity. */
  offsets: number[][];
  /** Left ankle, left toe, right ankle, right toe; empty where unknown. */
  feet: number[];
  /** Which joint is the body's hip, knee, …; without it the joints' own names tell. */
  roles?: Record<string, number>;
}

export class Skeleton {
  readonly name: string;
  readonly joints: readonly string[];
  readonly parents: readonly number[];
  readonly offsets: Float32Array;
  readonly feet: readonly number[];
  readonly roles: ReadonlyMap<string, number>;

  constructor(readonly data: SkeletonData) {
    const count = data.joints.length;
    const fits = count > 0 && data.parents.length === count && data.offsets.length === count;
    if (!fits || !data.parents.every((p, j) => (j === 0 ? p === -1 : p >= 0 && p < j))) {
      throw new Error(`the skeleton ${data.name} is not a tree whose parents come before their children`);
    }
    this.name = data.name;
    this.joints = data.joints;
    this.parents = data.parents;
    this.offsets = Float32Array.from(data.offsets.flat());
    this.feet = data.feet;
    this.roles = new Map(data.roles ? Object.entries(data.roles) : data.joints.map((name, j) => [name, j]));
  }

  get length(): number {
    return this.joints.length;
  }

  /** (J, 3) rest pose with the root at the origin. */
  restPositions(): Float32Array {
    const places = this.offsets.slice();
    for (let j = 1; j < this.length; j++) {
      for (let k = 0; k < 3; k++) places[3 * j + k] += places[3 * this.parents[j] + k];
    }
    return places;
  }

  /**
   * World positions and rotations from one row of a packet.
   *
   * @param row root position (3), then local rotations (J, 4), xyzw.
   * @param positions (J, 3) to be filled.
   * @param rotations (J, 4) to be filled.
   */
  forward(row: ArrayLike<number>, positions: Float32Array, rotations: Float32Array): void {
    for (let j = 0; j < this.length; j++) {
      const at = 3 + 4 * j;
      const bx = row[at], by = row[at + 1], bz = row[at + 2], bw = row[at + 3]; // prettier-ignore
      const parent = this.parents[j];
      if (parent < 0) {
        positions.set([row[0], row[1], row[2]], 0);
        rotations.set([bx, by, bz, bw], 0);
        continue;
      }
      const q = 4 * parent, p = 3 * parent; // prettier-ignore
      const ax = rotations[q], ay = rotations[q + 1], az = rotations[q + 2], aw = rotations[q + 3]; // prettier-ignore
      rotations[4 * j] = aw * bx + ax * bw + ay * bz - az * by;
      rotations[4 * j + 1] = aw * by - ax * bz + ay * bw + az * bx;
      rotations[4 * j + 2] = aw * bz + ax * by - ay * bx + az * bw;
      rotations[4 * j + 3] = aw * bw - ax * bx - ay * by - az * bz;
      // The offset turned by the parent: v + w t + u x t with t = 2 u x v.
      const vx = this.offsets[3 * j], vy = this.offsets[3 * j + 1], vz = this.offsets[3 * j + 2]; // prettier-ignore
      const tx = 2 * (ay * vz - az * vy), ty = 2 * (az * vx - ax * vz), tz = 2 * (ax * vy - ay * vx); // prettier-ignore
      positions[3 * j] = positions[p] + vx + aw * tx + ay * tz - az * ty;
      positions[3 * j + 1] = positions[p + 1] + vy + aw * ty + az * tx - ax * tz;
      positions[3 * j + 2] = positions[p + 2] + vz + aw * tz + ax * ty - ay * tx;
    }
  }
}
