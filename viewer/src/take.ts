/** Takes: motions that may grow while they are played. */

import { Skeleton } from "./skeleton";
import { fromBase64, type Packet, parsePackets, WireError } from "./wire";

/** Planted feet as moveset.motion.contacts.foot_contacts judges them: low and slow. */
const ANKLE_HEIGHT = 0.12;
const TOE_HEIGHT = 0.05;
const SPEED = 0.5;

export interface Pose {
  /** (J, 3) world positions, metres. */
  positions: Float32Array;
  /** (J, 4) world rotations, xyzw. */
  rotations: Float32Array;
}

export class Take {
  fps = 20;
  frames = 0;
  /** Another one after every change: frames that come once more need not be more. */
  revision = 0;
  private rows: Float32Array;
  private known: Uint8Array | null = null;
  private readonly row: Float32Array;
  private readonly scratch: [Float32Array, Float32Array];

  constructor(readonly skeleton: Skeleton) {
    this.rows = new Float32Array(64 * this.width);
    this.row = new Float32Array(this.width);
    this.scratch = [new Float32Array(3 * skeleton.length), new Float32Array(4 * skeleton.length)];
  }

  /** A take from packets, as bytes or as base64 texts. */
  static from(skeleton: Skeleton, data: ArrayBuffer | Uint8Array | string | string[]): Take {
    const take = new Take(skeleton);
    for (const part of Array.isArray(data) ? data : [data]) {
      for (const packet of parsePackets(typeof part === "string" ? fromBase64(part) : part)) take.append(packet);
    }
    if (take.frames === 0) throw new WireError("a take without frames");
    return take;
  }

  /** A take of its own with the same frames. */
  copy(): Take {
    const take = new Take(this.skeleton);
    [take.fps, take.frames, take.rows, take.known] = [this.fps, this.frames, this.allRows(), this.allContacts()];
    return take;
  }

  private get width(): number {
    return 3 + 4 * this.skeleton.length;
  }

  /** From the first frame to the last, in seconds. */
  get seconds(): number {
    return Math.max(0, this.frames - 1) / this.fps;
  }

  /** Add frames at the end; throws a WireError where they do not follow what is there. */
  append(packet: Packet): void {
    if (packet.joints !== this.skeleton.length) {
      throw new WireError(`a packet of ${packet.joints} joints does not fit the skeleton ${this.skeleton.name}`);
    }
    if (packet.firstFrame !== this.frames) {
      throw new WireError(`frame ${packet.firstFrame} came where ${this.frames} was to follow`);
    }
    if (this.frames > 0 && packet.fps !== this.fps) throw new WireError("a take cannot change its frame rate");
    const begun = this.frames;
    this.fps = packet.fps;
    this.frames += packet.frames;
    this.revision++;
    this.rows = grown(this.rows, this.frames * this.width);
    this.rows.set(packet.rows, begun * this.width);
    if (packet.contacts && (this.known || begun === 0)) {
      this.known = grown(this.known ?? new Uint8Array(256), 4 * this.frames);
      this.known.set(packet.contacts, 4 * begun);
    } else {
      this.known = null;
    }
  }

  /** Forget the frames from this one on: a stream may make anew what was not played yet. */
  truncate(frames: number): void {
    this.frames = Math.min(this.frames, Math.max(0, frames));
    this.revision++;
  }

  /** All frames, or those from one on, as the body of one packet, (F, 3 + 4 J). */
  allRows(first = 0): Float32Array {
    return this.rows.slice(first * this.width, this.frames * this.width);
  }

  /** (F, 4) planted feet of the same where packets told them, else null. */
  allContacts(first = 0): Uint8Array | null {
    return this.known?.slice(4 * first, 4 * this.frames) ?? null;
  }

  /** Root position and local rotations at a frame, which may lie between two: linear and slerp. */
  at(frame: number): Float32Array {
    const place = Math.min(Math.max(frame, 0), this.frames - 1);
    const low = Math.min(Math.floor(place), Math.max(0, this.frames - 2));
    const t = place - low;
    const a = this.rows.subarray(low * this.width, (low + 1) * this.width);
    if (t === 0) {
      this.row.set(a);
      return this.row;
    }
    const b = this.rows.subarray((low + 1) * this.width, (low + 2) * this.width);
    for (let k = 0; k < 3; k++) this.row[k] = a[k] + t * (b[k] - a[k]);
    for (let at = 3; at < this.width; at += 4) slerp(a, b, at, t, this.row);
    return this.row;
  }

  /** Position of the root joint at a frame. */
  root(frame: number): [number, number, number] {
    const row = this.at(frame);
    return [row[0], row[1], row[2]];
  }

  /** World positions and rotations of all joints at a frame, into `pose`. */
  pose(frame: number, pose: Pose): Pose {
    this.skeleton.forward(this.at(frame), pose.positions, pose.rotations);
    return pose;
  }

  /** (J, 3) world positions of all joints at a frame. */
  positions(frame: number): Float32Array {
    this.skeleton.forward(this.at(frame), this.scratch[0], this.scratch[1]);
    return this.scratch[0].slice();
  }

  /** Planted left ankle, left toe, right ankle, right toe at a frame: as told, else judged by height and speed. */
  contacts(frame: number): [boolean, boolean, boolean, boolean] {
    const whole = Math.min(Math.max(Math.floor(frame), 0), this.frames - 1);
    const known = this.known;
    if (known) return [0, 1, 2, 3].map((k) => known[4 * whole + k] !== 0) as [boolean, boolean, boolean, boolean];
    if (this.skeleton.feet.length !== 4 || this.frames < 2) return [false, false, false, false];
    const start = Math.min(whole, this.frames - 2);
    const [here, now, next] = [this.positions(whole), this.positions(start), this.positions(start + 1)];
    return this.skeleton.feet.map((j, k) => {
      const moved = Math.hypot(...[0, 1, 2].map((axis) => next[3 * j + axis] - now[3 * j + axis]));
      return here[3 * j + 1] < (k % 2 === 0 ? ANKLE_HEIGHT : TOE_HEIGHT) && moved * this.fps < SPEED;
    }) as [boolean, boolean, boolean, boolean];
  }
}

/** The same array, or one at least twice as long where it must grow. */
function grown<T extends Float32Array | Uint8Array>(array: T, length: number): T {
  if (array.length >= length) return array;
  const larger = new (array.constructor as new (length: number) => T)(Math.max(length, 2 * array.length));
  larger.set(array);
  return larger;
}

/** Between two quaternions along the shorter arc, at index `at` of both rows. */
function slerp(a: Float32Array, b: Float32Array, at: number, t: number, out: Float32Array): void {
  let dot = 0;
  for (let k = 0; k < 4; k++) dot += a[at + k] * b[at + k];
  const sign = dot < 0 ? -1 : 1;
  const angle = Math.acos(Math.min(1, Math.abs(dot)));
  const sine = Math.sin(angle);
  // Where the arc is tiny, the chord is as good, and the sine would divide by nothing.
  const [wa, wb] = sine < 1e-4 ? [1 - t, t] : [Math.sin((1 - t) * angle) / sine, Math.sin(t * angle) / sine];
  let norm = 0;
  for (let k = 0; k < 4; k++) {
    out[at + k] = wa * a[at + k] + sign * wb * b[at + k];
    norm += out[at + k] ** 2;
  }
  norm = Math.sqrt(norm);
  for (let k = 0; k < 4; k++) out[at + k] /= norm;
}
