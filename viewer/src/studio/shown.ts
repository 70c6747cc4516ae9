/** What is on the stage: takes with their titles and prompts, and the bytes that exports are made of. */
import { Skeleton } from "../skeleton";
import { Take } from "../take";
import { packPacket } from "../wire";
import type { Generated } from "./api";

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

/** A take as one packet, as POST /v1/export wants it. */
export function packets(take: Take): Uint8Array {
  const { fps, frames } = take;
  const joints = take.skeleton.length;
  return packPacket({ joints, frames, firstFrame: 0, fps, latencyMs: 0, rows: take.allRows(), contacts: take.allContacts() });
}
