/**
 * The mannequin: parts fixed to joints, in the joints' own axes, metres.
 *
 * Shells with round joints between them, so that nothing opens or pinches however a limb bends. Sizes are those of a
 * body whose legs measure LEG from hip to ankle; other bodies are scaled. The soles lie as low as the toe joints, since
 * motions stand with their lowest joint on the floor.
 */

import type { Skeleton } from "../skeleton";
import { add, type Frame, frameAlong, length, loft, type LoftOptions, patch, type Ring, type Surface, unit, type Vec } from "./loft"; // prettier-ignore

export type Tone = "shell" | "core" | "left" | "right" | "face";

export interface Part extends Surface {
  joint: number;
  tone: Tone;
}

const LEG = 0.82094;
const UP: Vec = [0, 1, 0];
const FRONT: Vec = [0, 0, 1];
const SIDES = ["left", "right"] as const;
type Side = (typeof SIDES)[number];

const HEAD: Ring[] = [
  { s: -0.03, a: 0.042, b: 0.046, v: 0.046 },
  { s: -0.008, a: 0.056, b: 0.066, v: 0.032 },
  { s: 0.03, a: 0.067, b: 0.084, v: 0.02 },
  { s: 0.085, a: 0.075, b: 0.095, v: 0.012 },
  { s: 0.13, a: 0.071, b: 0.089, v: 0.006 },
  { s: 0.158, a: 0.056, b: 0.07, v: 0.001 },
];
const NECK: Ring[] = [
  { s: -0.05, a: 0.054, b: 0.05, v: -0.006 },
  { s: 0.03, a: 0.045, b: 0.046, v: 0.008 },
  { s: 0.1, a: 0.046, b: 0.05, v: 0.038 },
];
const CHEST: Ring[] = [
  { s: -0.075, a: 0.108, b: 0.08, v: 0.012 },
  { s: -0.03, a: 0.127, b: 0.094, v: 0.014 },
  { s: 0.03, a: 0.145, b: 0.107, v: 0.013 },
  { s: 0.08, a: 0.153, b: 0.107, v: 0.005 },
  { s: 0.125, a: 0.146, b: 0.094, v: -0.01 },
  { s: 0.165, a: 0.112, b: 0.074, v: -0.022 },
  { s: 0.197, a: 0.07, b: 0.055, v: -0.029 },
];
const PELVIS: Ring[] = [
  { s: -0.12, a: 0.062, b: 0.062, v: -0.012 },
  { s: -0.09, a: 0.115, b: 0.092, v: -0.02 },
  { s: -0.045, a: 0.146, b: 0.111, v: -0.024 },
  { s: 0.005, a: 0.143, b: 0.108, v: -0.022 },
  { s: 0.05, a: 0.128, b: 0.097, v: -0.017 },
];
/** Lengths along limbs are parts of the whole. */
const THIGH: Ring[] = [
  { s: 0.0, a: 0.07, b: 0.078 },
  { s: 0.12, a: 0.077, b: 0.086, v: 0.002 },
  { s: 0.35, a: 0.075, b: 0.083, v: 0.006 },
  { s: 0.65, a: 0.06, b: 0.067, v: 0.005 },
  { s: 0.88, a: 0.05, b: 0.055, v: 0.001 },
];
const SHIN: Ring[] = [
  { s: 0.09, a: 0.046, b: 0.05, v: -0.001 },
  { s: 0.22, a: 0.05, b: 0.057, v: -0.011 },
  { s: 0.36, a: 0.05, b: 0.058, v: -0.014 },
  { s: 0.6, a: 0.04, b: 0.045, v: -0.009 },
  { s: 0.85, a: 0.032, b: 0.034, v: -0.003 },
  { s: 0.92, a: 0.031, b: 0.033, v: -0.002 },
];
const UPPER_ARM: Ring[] = [
  { s: 0.11, a: 0.0515, b: 0.0525 },
  { s: 0.28, a: 0.05, b: 0.0525 },
  { s: 0.55, a: 0.044, b: 0.046, v: 0.002 },
  { s: 0.86, a: 0.036, b: 0.037 },
];
const FOREARM: Ring[] = [
  { s: 0.12, a: 0.037, b: 0.037 },
  { s: 0.28, a: 0.039, b: 0.039 },
  { s: 0.6, a: 0.031, b: 0.032 },
  { s: 0.9, a: 0.023, b: 0.027 },
];
const PALM: Ring[] = [
  { s: 0.018, a: 0.017, b: 0.027, v: 0.001 },
  { s: 0.05, a: 0.0165, b: 0.038, v: 0.001 },
  { s: 0.088, a: 0.0135, b: 0.04 },
];
/** Place across the palm, length and thickness of fore-, middle, ring and little finger. */
const FINGERS = [
  [0.029, 0.066, 0.0088],
  [0.0105, 0.074, 0.009],
  [-0.0085, 0.069, 0.0087],
  [-0.0265, 0.053, 0.0078],
] as const;

/** Parts of the mannequin for a skeleton with human roles; for any other tree a slim part for every bone. */
export function mannequin(skeleton: Skeleton, coarse = false): Part[] {
  const { roles } = skeleton;
  const needed = SIDES.flatMap((side) => ["hip", "knee", "ankle"].map((end) => `${side}_${end}`));
  if (!["pelvis", ...needed].every((role) => roles.has(role))) return bones(skeleton);
  return new Builder(skeleton, coarse).build();
}

class Builder {
  private readonly parts: Part[] = [];
  private readonly rest: Float32Array;
  private readonly size: number;

  constructor(
    private readonly skeleton: Skeleton,
    private readonly coarse: boolean,
  ) {
    this.rest = skeleton.restPositions();
    const legs = SIDES.map((side) => length(this.reach(side, "hip", "knee")) + length(this.reach(side, "knee", "ankle")));
    this.size = (legs[0] + legs[1]) / 2 / LEG;
  }

  build(): Part[] {
    const trunk = frameAlong(UP, FRONT);
    this.shape("pelvis", "shell", trunk, PELVIS, { caps: [0.022, 0.03], around: 26, square: 2.25 });
    // Three barrels deep in one another: the waist bends without a gap.
    this.barrel("pelvis", trunk, 0.03, 0.085, -0.014);
    this.barrel("spine1", trunk, -0.045, 0.095, 0.024);
    this.barrel("spine2", trunk, -0.085, 0.05, 0.002);
    const chest = this.has("spine3") ? "spine3" : this.has("spine2") ? "spine2" : "spine1";
    this.shape(chest, "shell", trunk, CHEST, { caps: [0.03, 0.012], around: 26, square: 2.2 });
    this.shape("neck", "core", trunk, NECK, { caps: [0.01, 0.01] });
    this.shape("head", "shell", trunk, HEAD, { caps: [0.012, 0.022], around: 26 });
    if (this.has("head")) {
      const visor = { centre: 0.072, reach: 0.028, angle: 1.02, height: 0.0045 };
      this.add("head", "face", patch(this.sized(trunk), HEAD.map((ring) => this.scaled(ring)), this.scaled(visor, ["angle"])));
    }
    for (const side of SIDES) {
      this.leg(side);
      this.arm(side);
    }
    return this.parts;
  }

  private leg(side: Side): void {
    this.limb(side, "hip", "knee", THIGH, [0.05, 0.02]);
    const shin = frameAlong(this.reach(side, "knee", "ankle"), FRONT);
    this.ball(`${side}_knee`, side, shin, 0, [0.05, 0.05, 0.053], 0.002);
    this.limb(side, "knee", "ankle", SHIN, [0.022, 0.014]);
    this.ball(`${side}_ankle`, side, shin, 0, [0.0345, 0.034, 0.036]);

    const toe = this.has(`${side}_foot`) ? this.reach(side, "ankle", "foot") : ([0, -0.0644 * this.size, 0.1318 * this.size] as Vec); // prettier-ignore
    const [drop, ahead] = [toe[1] / this.size, toe[2] / this.size];
    const inward = toe[0] / this.size;
    const sole = (s: number, a: number, b: number, along = s / ahead): Ring => ({ s, a, b, u: inward * along, v: drop + b }); // prettier-ignore
    const foot = [
      sole(-0.052, 0.031, 0.026, 0),
      sole(-0.035, 0.036, 0.035, 0),
      sole(0.0, 0.037, 0.044),
      sole(0.045, 0.039, 0.038),
      sole(0.09, 0.044, 0.028),
      sole(ahead - 0.004, 0.046, 0.0205),
    ];
    this.shape(`${side}_ankle`, "shell", frameAlong(FRONT, UP), foot, { caps: [0.016, 0.012], square: 2.7 });
    const hasToe = this.has(`${side}_foot`);
    const tip = (s: number, a: number, b: number): Ring => {
      return hasToe ? { s, a, b, v: b } : { s: s + ahead, a, b, u: inward, v: drop + b };
    };
    const toes = [tip(0.004, 0.045, 0.0195), tip(0.03, 0.044, 0.017), tip(0.052, 0.036, 0.0135)];
    this.shape(`${side}_${hasToe ? "foot" : "ankle"}`, side, frameAlong(FRONT, UP), toes, { caps: [0.012, 0.014], square: 2.5 }); // prettier-ignore
  }

  private arm(side: Side): void {
    if (![`${side}_shoulder`, `${side}_elbow`, `${side}_wrist`].every((role) => this.has(role))) return;
    if (this.has(`${side}_collar`)) {
      const across = this.reach(side, "collar", "shoulder");
      const rings = [0.15, 0.6, 1].map((s) => ({ s: (s * length(across)) / this.size, a: 0.05 - 0.006 * s, b: 0.052 - 0.006 * s }));
      this.shape(`${side}_collar`, "shell", frameAlong(across, FRONT), rings, { caps: [0.03, 0.03] });
    }
    const upper = frameAlong(this.reach(side, "shoulder", "elbow"), FRONT);
    this.ball(`${side}_shoulder`, side, upper, 0, [0.053, 0.053, 0.053]);
    this.limb(side, "shoulder", "elbow", UPPER_ARM, [0.022, 0.014]);
    const lower = frameAlong(this.reach(side, "elbow", "wrist"), FRONT);
    this.ball(`${side}_elbow`, side, lower, 0, [0.0365, 0.0365, 0.0365]);
    this.limb(side, "elbow", "wrist", FOREARM, [0.018, 0.01]);
    this.ball(`${side}_wrist`, side, lower, 0, [0.0245, 0.0245, 0.026]);
    this.hand(side, lower);
  }

  /** Flat, palm down, where the arm is stretched out sideways; the thumb points to the front. */
  private hand(side: Side, lower: Frame): void {
    // u points up on the left side and down on the right one.
    const palm = side === "left" ? -1 : 1;
    const wrist = `${side}_wrist`;
    this.shape(wrist, "shell", lower, PALM, { caps: [0.014, 0.012], square: 2.6 });
    for (const [across, reach, thick] of FINGERS) {
      const bent = [0, 0.34, 0.68, 1].map((t) => ({
        s: 0.09 + reach * (t - 0.14 * t * t), a: thick * (1 - 0.16 * t), b: thick * (1 - 0.12 * t),
        u: palm * (0.002 + 0.3 * reach * t * t), v: across * (1 - 0.06 * t),
      })); // prettier-ignore
      this.shape(wrist, "shell", lower, bent, { caps: [0.008, 0.008], around: 8, between: 1 });
    }
    const root = add(add([0, 0, 0], lower.d, 0.03), lower.v, 0.022);
    const along = add(add(lower.d, lower.v, 0.72), lower.u, 0.28 * palm);
    const thumb = [0, 0.5, 1].map((t) => ({ s: 0.056 * t, a: 0.0125 - 0.003 * t, b: 0.0125 - 0.003 * t, v: -0.006 * t * t })); // prettier-ignore
    this.shape(wrist, "shell", { ...frameAlong(along, lower.v), origin: root }, thumb, { caps: [0.012, 0.009], around: 8, between: 1 }); // prettier-ignore
  }

  private limb(side: Side, start: string, end: string, rings: readonly Ring[], caps: [number, number]): void {
    const reach = this.reach(side, start, end);
    const along = length(reach) / this.size;
    const placed = rings.map((ring) => ({ ...ring, s: ring.s * along }));
    this.shape(`${side}_${start}`, "shell", frameAlong(reach, FRONT), placed, { caps });
  }

  private barrel(role: string, frame: Frame, from: number, to: number, v: number): void {
    const rings = [0, 0.5, 1].map((t) => ({ s: from + t * (to - from), a: t === 0.5 ? 0.107 : 0.099, b: t === 0.5 ? 0.083 : 0.077, v })); // prettier-ignore
    this.shape(role, "core", frame, rings, { caps: [0.045, 0.045], around: 26 });
  }

  /** An ellipsoid at `s` along a frame; radii along u, d and v. */
  private ball(role: string, tone: Tone, frame: Frame, s: number, [a, along, b]: Vec, v = 0): void {
    this.shape(role, tone, frame, [{ s, a, b, v }], { caps: [along, along], around: 18 });
  }

  private shape(role: string, tone: Tone, frame: Frame, rings: readonly Ring[], options: LoftOptions): void {
    if (!this.has(role)) return;
    const caps = options.caps.map((cap) => cap * this.size) as [number, number];
    this.add(role, tone, loft(this.sized(frame), rings.map((ring) => this.scaled(ring)), { ...options, ...this.fineness(options), caps }));
  }

  private fineness({ around = 18, between = 2 }: LoftOptions): Pick<LoftOptions, "around" | "between"> {
    return this.coarse ? { around: Math.max(6, Math.round(0.6 * around)), between: 1 } : { around, between };
  }

  private add(role: string, tone: Tone, surface: Surface): void {
    this.parts.push({ ...surface, tone, joint: this.skeleton.roles.get(role)! });
  }

  private has(role: string): boolean {
    return this.skeleton.roles.has(role);
  }

  private sized(frame: Frame): Frame {
    return { ...frame, origin: frame.origin.map((value) => value * this.size) as unknown as Vec };
  }

  private scaled<T extends object>(lengths: T, except: (keyof T)[] = []): T {
    const entries = Object.entries(lengths).map(([k, v]) => [k, except.includes(k as keyof T) ? v : v * this.size]);
    return Object.fromEntries(entries) as T;
  }

  private reach(side: Side, start: string, end: string): Vec {
    const [a, b] = [start, end].map((name) => 3 * this.skeleton.roles.get(`${side}_${name}`)!);
    return [0, 1, 2].map((k) => this.rest[b + k] - this.rest[a + k]) as unknown as Vec;
  }
}

/** One part for every bone, a tenth as thick as long. */
function bones(skeleton: Skeleton): Part[] {
  const parts: Part[] = [];
  skeleton.parents.forEach((parent, joint) => {
    const reach = Array.from(skeleton.offsets.subarray(3 * joint, 3 * joint + 3)) as unknown as Vec;
    const long = length(reach);
    if (parent < 0 || long < 1e-6) return;
    const r = Math.min(Math.max(0.1 * long, 0.01), 0.05);
    const rings = [{ s: 0, a: r, b: r }, { s: long, a: 0.8 * r, b: 0.8 * r }]; // prettier-ignore
    const frame = frameAlong(reach, Math.abs(unit(reach)[2]) < 0.9 ? FRONT : UP);
    parts.push({ ...loft(frame, rings, { caps: [r, 0.8 * r], around: 12, between: 1 }), joint: parent, tone: "shell" });
  });
  return parts;
}
