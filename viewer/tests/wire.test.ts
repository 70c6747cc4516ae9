import { describe, expect, it } from "vitest";
import { fromBase64, packPacket, parsePackets, WireError } from "../src/wire";
import { bytesOf, STILL } from "./packets";

const ROW = [1, 2, 3, ...STILL];

describe("parsePackets", () => {
  it("reads what the format says", () => {
    const [packet] = parsePackets(bytesOf([ROW, ROW], { first: 2 ** 33, fps: 30, contacts: [[1, 0, 0, 1], [0, 1, 1, 0]] }));
    expect(packet).toMatchObject({ joints: 1, frames: 2, firstFrame: 2 ** 33, fps: 30, latencyMs: 12.5 });
    expect([...packet.rows]).toEqual([...ROW, ...ROW]);
    expect([...packet.contacts!]).toEqual([1, 0, 0, 1, 0, 1, 1, 0]);
  });

  it("reads packets back to back, at any alignment", () => {
    const one = bytesOf([ROW], { contacts: [[1, 1, 1, 1]] });
    const both = new Uint8Array([9, ...one, ...bytesOf([ROW], { first: 1 })]).subarray(1);
    expect(parsePackets(both).map((packet) => packet.firstFrame)).toEqual([0, 1]);
  });

  it("writes what it reads", () => {
    const bytes = bytesOf([ROW, ROW], { first: 7, contacts: [[1, 0, 0, 1], [0, 1, 1, 0]] });
    expect(packPacket(parsePackets(bytes)[0])).toEqual(bytes);
  });

  it("refuses every cut", () => {
    const bytes = bytesOf([ROW, ROW], { contacts: [[1, 0, 0, 1], [0, 1, 1, 0]] });
    for (let length = 1; length < bytes.length; length++) {
      expect(() => parsePackets(bytes.subarray(0, length)), `${length} bytes`).toThrow(WireError);
    }
  });

  it.each([
    ["another magic", 0, 0x58],
    ["another version", 4, 2],
    ["no joints", 6, 0],
    ["too many joints", 7, 255],
    ["absurdly many frames", 11, 255],
    ["a frame rate that is not a number", 23, 0x7f],
    ["values that are not finite", 35, 0xff],
  ])("refuses %s", (_, at, value) => {
    const bytes = bytesOf([ROW]);
    bytes[at] = value;
    if (at === 23) bytes[22] = 0xc0;
    if (at === 35) bytes[34] = 0xc0;
    expect(() => parsePackets(bytes)).toThrow(WireError);
  });
});

it("decodes base64", () => {
  expect([...fromBase64("AAEC\n/w==")]).toEqual([0, 1, 2, 255]);
});
