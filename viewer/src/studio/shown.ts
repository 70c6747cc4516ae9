/** What is on the stage: takes with their titles and prompts, and the bytes that exports are made of. */
import { Skeleton } from "../skeleton";
import { Take } from "../take";
import { packetBytes, packPacket } from "../wire";
import type { ExportLimits, Generated } from "./api";

export interface Mark {
  text: string;
  firstFrame: number;
}

export interface ShownTake {
  take: Take;
  title: string;
  seed: number;
  prompts: Mark[];
}

export interface Shown {
  kind: "clip" | "live";
  title: string;
  takes: ShownTake[];
}

/** The takes of an answer. */
export function fromAnswer(answer: Generated): Shown {
  const skeleton = new Skeleton(answer.skeleton);
  const takes = answer.takes.map((one) => {
    const prompts = one.prompts.map(({ text, first_frame }) => ({ text, firstFrame: first_frame }));
    const take = Take.from(skeleton, one.data);
    return { take, title: answer.takes.length > 1 ? `Seed ${one.seed}` : "", seed: one.seed, prompts };
  });
  return { kind: "clip", title: answer.takes[0].prompts.map((prompt) => prompt.text).join(", then "), takes };
}

/** First frame of the newest part of a take that the server writes as one file; 0 where that is all of it. */
export function firstThatFits(take: Take, format: string, fps: number, limits: ExportLimits): number {
  const joints = take.skeleton.length;
  const header = packetBytes(joints, 0, true);
  const bytes = (limits.export - header) / (packetBytes(joints, 1, true) - header);
  const drawn = format === "mp4" ? limits.picture_seconds : Infinity;
  const seconds = Math.min(limits.frames / Math.max(fps, take.fps), drawn);
  return Math.max(0, take.frames - Math.floor(Math.min(bytes, seconds * take.fps)));
}

/** A take from a frame on as one packet, as POST /v1/export wants it. */
export function packets(take: Take, first = 0): Uint8Array {
  const [joints, frames] = [take.skeleton.length, take.frames - first];
  const [rows, contacts] = [take.allRows(first), take.allContacts(first)];
  return packPacket({ joints, frames, firstFrame: 0, fps: take.fps, latencyMs: 0, rows, contacts });
}
