/** Packets for tests, written byte by byte from the format's description. */

export function bytesOf(
  rows: number[][],
  { first = 0, fps = 20, contacts = null as number[][] | null, joints = (rows[0].length - 3) / 4 } = {},
): Uint8Array {
  const body = rows.flat();
  const bytes = new Uint8Array(32 + 4 * body.length + (contacts ? 4 * contacts.length : 0));
  const view = new DataView(bytes.buffer);
  "MVST".split("").forEach((letter, k) => view.setUint8(k, letter.charCodeAt(0)));
  view.setUint16(4, 1, true);
  view.setUint16(6, joints, true);
  view.setUint32(8, rows.length, true);
  view.setBigUint64(12, BigInt(first), true);
  view.setFloat32(20, fps, true);
  view.setFloat32(24, 12.5, true);
  view.setUint32(28, contacts ? 1 : 0, true);
  body.forEach((value, k) => view.setFloat32(32 + 4 * k, value, true));
  contacts?.flat().forEach((value, k) => view.setUint8(32 + 4 * body.length + k, value));
  return bytes;
}

/** A root and one child 1 m above it. */
export const ARM = { name: "arm", joints: ["a", "b"], parents: [-1, 0], offsets: [[0, 0, 0], [0, 1, 0]], feet: [] }; // prettier-ignore
export const STILL = [0, 0, 0, 1];
/** A quarter turn about z: up becomes -x. */
export const QUARTER = [0, 0, Math.SQRT1_2, Math.SQRT1_2];
