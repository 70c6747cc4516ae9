/** Closed surfaces through rings of ellipses along an axis: what the mannequin is made of. */

export type Vec = readonly [number, number, number];

/** A cross-section: `a` and `b` are half its width along u and v, `u` and `v` shift its centre, metres. */
export interface Ring {
  s: number;
  a: number;
  b: number;
  u?: number;
  v?: number;
}

/** Where a surface stands: a point, its axis d, and u, v across it; u x v = d. */
export interface Frame {
  origin: Vec;
  d: Vec;
  u: Vec;
  v: Vec;
}

export interface Surface {
  positions: number[];
  triangles: number[];
}

export const add = (a: Vec, b: Vec, t = 1): Vec => [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]];
const dot = (a: Vec, b: Vec) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a: Vec, b: Vec): Vec => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const length = (a: Vec) => Math.hypot(...a);
export const unit = (a: Vec): Vec => [a[0] / length(a), a[1] / length(a), a[2] / length(a)];

/** A frame at `origin` along `axis` whose v points towards `front` as far as it can. */
export function frameAlong(axis: Vec, front: Vec, origin: Vec = [0, 0, 0]): Frame {
  const d = unit(axis);
  let v = add(front, d, -dot(front, d));
  if (length(v) < 1e-3) v = add([0, 1, 0], d, -d[1]);
  v = unit(v);
  return { origin, d, u: cross(v, d), v };
}

/** A ring between given ones, by a Catmull-Rom curve; beyond them the nearest. */
function ringAt(rings: readonly Ring[], s: number): Required<Ring> {
  const last = rings.length - 1;
  let i = 0;
  while (i < last - 1 && rings[i + 1].s < s) i++;
  const [p, q] = [rings[i], rings[Math.min(i + 1, last)]];
  const t = q.s > p.s ? Math.min(Math.max((s - p.s) / (q.s - p.s), 0), 1) : 0;
  const before = rings[Math.max(i - 1, 0)];
  const after = rings[Math.min(i + 2, last)];
  const curve = (key: "a" | "b" | "u" | "v") => {
    const [p0, p1, p2, p3] = [before, p, q, after].map((ring) => ring[key] ?? 0);
    const m1 = slope(before.s, q.s, p0, p2) * (q.s - p.s);
    const m2 = slope(p.s, after.s, p1, p3) * (q.s - p.s);
    const [t2, t3] = [t * t, t * t * t];
    return (2 * t3 - 3 * t2 + 1) * p1 + (t3 - 2 * t2 + t) * m1 + (3 * t2 - 2 * t3) * p2 + (t3 - t2) * m2;
  };
  return { s, a: curve("a"), b: curve("b"), u: curve("u"), v: curve("v") };
}

const slope = (s0: number, s1: number, p0: number, p1: number) => (s1 > s0 ? (p1 - p0) / (s1 - s0) : 0);

export interface LoftOptions {
  /** How far the rounded ends reach beyond the first and the last ring. */
  caps: readonly [number, number];
  /** Corners of a ring. */
  around?: number;
  /** Rings between two given ones. */
  between?: number;
  /** 2: ellipses; more: rounder boxes. */
  square?: number;
}

/** The surface through the rings, closed by rounded ends. */
export function loft(frame: Frame, rings: readonly Ring[], options: LoftOptions): Surface {
  const { caps, around = 18, between = 2, square = 2 } = options;
  const levels: Required<Ring>[] = [];
  const [first, last] = [rings[0], rings[rings.length - 1]];
  const capRings = 3;
  for (let k = 1; k <= capRings; k++) {
    const angle = (0.5 * Math.PI * k) / capRings;
    levels.push(shrunk(ringAt(rings, first.s), Math.sin(angle), -caps[0] * Math.cos(angle)));
  }
  for (let i = 0; i + 1 < rings.length; i++) {
    for (let k = 1; k <= between; k++) {
      levels.push(ringAt(rings, rings[i].s + ((rings[i + 1].s - rings[i].s) * k) / between));
    }
  }
  for (let k = 1; k < capRings; k++) {
    const angle = (0.5 * Math.PI * k) / capRings;
    levels.push(shrunk(ringAt(rings, last.s), Math.cos(angle), caps[1] * Math.sin(angle)));
  }
  const positions: number[] = [];
  const place = (s: number, u: number, v: number) => {
    for (let k = 0; k < 3; k++) {
      positions.push(frame.origin[k] + s * frame.d[k] + u * frame.u[k] + v * frame.v[k]);
    }
  };
  place(first.s - caps[0], first.u ?? 0, first.v ?? 0);
  for (const ring of levels) {
    for (let k = 0; k < around; k++) {
      const [x, y] = onRing((2 * Math.PI * k) / around, square);
      place(ring.s, ring.u + ring.a * x, ring.v + ring.b * y);
    }
  }
  place(last.s + caps[1], last.u ?? 0, last.v ?? 0);
  return { positions, triangles: sheet(levels.length, around) };
}

function shrunk(ring: Required<Ring>, size: number, along: number): Required<Ring> {
  return { ...ring, s: ring.s + along, a: ring.a * size, b: ring.b * size };
}

/** A point of the unit circle, or of a rounder box for exponents above 2. */
function onRing(angle: number, square: number): [number, number] {
  const [x, y] = [Math.cos(angle), Math.sin(angle)];
  const power = 2 / square;
  return [Math.sign(x) * Math.abs(x) ** power, Math.sign(y) * Math.abs(y) ** power];
}

/** Triangles of a pole, `levels` rings of `around` points, and a pole; counter-clockwise from outside. */
function sheet(levels: number, around: number): number[] {
  const triangles: number[] = [];
  const at = (level: number, k: number) => 1 + level * around + (k % around);
  for (let k = 0; k < around; k++) triangles.push(0, at(0, k + 1), at(0, k));
  for (let level = 0; level + 1 < levels; level++) {
    for (let k = 0; k < around; k++) {
      triangles.push(at(level, k), at(level, k + 1), at(level + 1, k));
      triangles.push(at(level, k + 1), at(level + 1, k + 1), at(level + 1, k));
    }
  }
  const pole = 1 + levels * around;
  for (let k = 0; k < around; k++) triangles.push(pole, at(levels - 1, k), at(levels - 1, k + 1));
  return triangles;
}

/** A round patch that lies a little above the surface through the rings, seen from v; for the face. */
export function patch(
  frame: Frame,
  rings: readonly Ring[],
  { centre, reach, angle, height }: { centre: number; reach: number; angle: number; height: number },
): Surface {
  const [rounds, around] = [6, 32];
  const positions: number[] = [];
  const place = (r: number, t: number) => {
    const [x, y] = onRing(t, 3.2);
    const ring = ringAt(rings, centre + reach * r * y);
    const phi = 0.5 * Math.PI - angle * r * x;
    // Rounded towards its rim, which stays just above the surface.
    const over = 1 + (0.0007 + height * (1 - r ** 6)) / ring.b;
    const [u, v] = [ring.u + over * ring.a * Math.cos(phi), ring.v + over * ring.b * Math.sin(phi)];
    for (let k = 0; k < 3; k++) {
      positions.push(frame.origin[k] + ring.s * frame.d[k] + u * frame.u[k] + v * frame.v[k]);
    }
  };
  place(0, 0);
  for (let r = 1; r <= rounds; r++) for (let k = 0; k < around; k++) place(r / rounds, (2 * Math.PI * k) / around);
  const at = (r: number, k: number) => 1 + r * around + (k % around);
  const triangles: number[] = [];
  for (let k = 0; k < around; k++) triangles.push(0, at(0, k + 1), at(0, k));
  for (let r = 0; r + 1 < rounds; r++) {
    for (let k = 0; k < around; k++) {
      triangles.push(at(r, k), at(r, k + 1), at(r + 1, k));
      triangles.push(at(r, k + 1), at(r + 1, k + 1), at(r + 1, k));
    }
  }
  return { positions, triangles };
}
