/**
 * Packets: how motion travels between moveset's server, its pages and its files.
 *
 * A packet is a header of 32 bytes, little-endian, and its body:
 *   0 "MVST" | 4 u16 version = 1 | 6 u16 joints J | 8 u32 frames n | 12 u64 first frame | 20 f32 fps
 *   24 f32 latency in ms | 28 u32 flags
 * then float32 (n, 3 + 4 J): root position in metres (Y up, facing +Z), then local rotations xyzw in skeleton order;
 * with flag bit 0 also u8 (n, 4): planted left ankle, left toe, right ankle, right toe.
 * A take is packets back to back whose frames follow one another.
 */

const HEADER = 32;
const MAGIC = 0x5453564d; // "MVST" read as a little-endian u32
const VERSION = 1;
const CONTACTS = 1;

/** Limits of what is accepted: far above what moveset makes, far below what could exhaust a page. */
const MAX_JOINTS = 512;
const MAX_FRAMES = 1_000_000;

export interface Packet {
  joints: number;
  frames: number;
  firstFrame: number;
  fps: number;
  latencyMs: number;
  /** (n, 3 + 4 J) root position and local rotations. */
  rows: Float32Array;
  /** (n, 4) planted feet, where they are known. */
  contacts: Uint8Array | null;
}

/** Bytes that are not packets. */
export class WireError extends Error {
  override name = "WireError";
}

/** The packets of a buffer, whole; throws a WireError for anything else. */
export function parsePackets(data: ArrayBuffer | Uint8Array): Packet[] {
  const bytes = data instanceof Uint8Array ? data : new Uint8Array(data);
  const packets: Packet[] = [];
  let at = 0;
  while (at < bytes.length) {
    const packet = parsePacket(bytes, at);
    packets.push(packet);
    at += packetBytes(packet.joints, packet.frames, packet.contacts !== null);
  }
  return packets;
}

function parsePacket(bytes: Uint8Array, at: number): Packet {
  if (bytes.length - at < HEADER) throw new WireError(`a packet's header is cut off at byte ${at}`);
  const view = new DataView(bytes.buffer, bytes.byteOffset + at, bytes.length - at);
  if (view.getUint32(0, true) !== MAGIC) throw new WireError(`no packet begins at byte ${at}`);
  const version = view.getUint16(4, true);
  if (version !== VERSION) throw new WireError(`packet version ${version} is not ${VERSION}; reload the page`);
  const joints = view.getUint16(6, true);
  const frames = view.getUint32(8, true);
  const firstFrame = Number(view.getBigUint64(12, true));
  const fps = view.getFloat32(20, true);
  const latencyMs = view.getFloat32(24, true);
  const withContacts = (view.getUint32(28, true) & CONTACTS) !== 0;
  if (joints < 1 || joints > MAX_JOINTS || frames < 1 || frames > MAX_FRAMES) {
    throw new WireError(`a packet of ${frames} frames of ${joints} joints is out of range`);
  }
  if (!(fps > 0 && fps <= 1000)) throw new WireError(`a packet at ${fps} frames per second is out of range`);
  if (packetBytes(joints, frames, withContacts) > bytes.length - at) {
    throw new WireError(`the packet at byte ${at} is cut off`);
  }
  const floats = frames * (3 + 4 * joints);
  // A packet may begin anywhere in a buffer, and typed arrays must be aligned: copy.
  const body = bytes.slice(at + HEADER, at + packetBytes(joints, frames, withContacts));
  const rows = new Float32Array(body.buffer, 0, floats);
  if (!rows.every(Number.isFinite)) throw new WireError(`the packet at byte ${at} has numbers that are not finite`);
  const contacts = withContacts ? body.subarray(4 * floats) : null;
  return { joints, frames, firstFrame, fps, latencyMs, rows, contacts };
}

/** Size of a packet. */
export function packetBytes(joints: number, frames: number, contacts: boolean): number {
  return HEADER + frames * (4 * (3 + 4 * joints) + (contacts ? 4 : 0));
}

/** The bytes of a packet. */
export function packPacket(packet: Packet): Uint8Array {
  const { joints, frames, rows, contacts } = packet;
  const bytes = new Uint8Array(packetBytes(joints, frames, contacts !== null));
  const view = new DataView(bytes.buffer);
  view.setUint32(0, MAGIC, true);
  view.setUint16(4, VERSION, true);
  view.setUint16(6, joints, true);
  view.setUint32(8, frames, true);
  view.setBigUint64(12, BigInt(packet.firstFrame), true);
  view.setFloat32(20, packet.fps, true);
  view.setFloat32(24, packet.latencyMs, true);
  view.setUint32(28, contacts ? CONTACTS : 0, true);
  new Float32Array(bytes.buffer, HEADER, rows.length).set(rows);
  if (contacts) bytes.set(contacts, HEADER + 4 * rows.length);
  return bytes;
}

/** Bytes of a base64 text; white space in it is ignored. */
export function fromBase64(text: string): Uint8Array {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}
