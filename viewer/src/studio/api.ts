/** The REST side of the server, typed. Every call either answers, or throws ServerError or Unreachable. */
import type { SkeletonData } from "../skeleton";

export interface ModelInfo {
  name: string;
  task: "clip" | "stream";
  fps: number;
  steps: number[];
  default_steps: number;
  guidance: number;
  min_seconds?: number;
  max_seconds: number | null;
}

/** What POST /v1/export takes. */
export interface ExportLimits {
  /** Bytes of packets. */
  export: number;
  /** Seconds of a motion to be drawn. */
  picture_seconds: number;
  /** Frames, at the rate of the file. */
  frames: number;
}

export interface Models {
  models: ModelInfo[];
  default: { clip: string | null; stream: string | null };
  /** What POST /v1/export can make, among others. */
  formats: string[];
  limits: ExportLimits;
  skeleton: SkeletonData;
}

export interface PromptRequest {
  text: string;
  seconds: number | null;
}

export interface GenerateRequest {
  prompts: PromptRequest[];
  model: string | null;
  steps: number | null;
  seed: number | null;
  num: number;
}

export interface TakeAnswer {
  seed: number;
  frames: number;
  fps: number;
  seconds: number;
  prompts: { text: string; first_frame: number }[];
  data: string;
}

export interface Generated {
  model: string;
  seed: number;
  steps: number;
  timings_ms: Record<string, number>;
  warnings: string[];
  skeleton: SkeletonData;
  takes: TakeAnswer[];
}

export interface ExportOptions {
  skeleton: string | null;
  fps: number | null;
  in_place: boolean;
  loop: boolean;
  title: string;
}

/** The server refused, in a sentence made for people. */
export class ServerError extends Error {
  constructor(
    message: string,
    readonly status: number,
    readonly code: string,
  ) {
    super(message);
  }
}

/** Nobody answers: the server was stopped, or the network is gone. */
export class Unreachable extends Error {
  constructor() {
    super("The server does not answer. Start it again with: moveset serve");
  }
}

async function ask(path: string, init: RequestInit = {}): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(path, init);
  } catch (fault) {
    if (init.signal?.aborted) throw fault;
    throw new Unreachable();
  }
  if (answer.ok) return answer;
  let message = `The server answered ${answer.status} ${answer.statusText}.`;
  let code = "error";
  if (answer.headers.get("content-type")?.includes("json")) {
    const body = (await answer.json()) as { error?: { code?: string; message?: string } };
    message = body.error?.message ?? message;
    code = body.error?.code ?? code;
  }
  throw new ServerError(message, answer.status, code);
}

/** What can be asked of this server. */
export async function models(): Promise<Models> {
  return (await ask("/v1/models")).json();
}

/** Sentences that a model knows. */
export async function prompts(model: string): Promise<string[]> {
  const answer = await ask(`/v1/prompts?${new URLSearchParams({ model })}`);
  return ((await answer.json()) as { prompts: string[] }).prompts;
}

/** Takes for a sentence or a timeline of them. */
export async function generate(request: GenerateRequest, signal: AbortSignal): Promise<Generated> {
  const body = JSON.stringify({ ...request, format: "json" });
  const headers = { "Content-Type": "application/json" };
  return (await ask("/v1/generate", { method: "POST", headers, body, signal })).json();
}

/** A file of what the page shows, with the name that the server gave it. */
export async function exportFile(
  format: string,
  packets: Uint8Array,
  options: ExportOptions,
): Promise<{ blob: Blob; name: string }> {
  const query = new URLSearchParams({ format, title: options.title });
  if (options.skeleton) query.set("skeleton", options.skeleton);
  if (options.fps) query.set("fps", String(options.fps));
  if (options.in_place) query.set("in_place", "true");
  if (options.loop) query.set("loop", "true");
  const answer = await ask(`/v1/export?${query}`, {
    method: "POST",
    headers: { "Content-Type": "application/octet-stream" },
    body: packets as Uint8Array<ArrayBuffer>,
  });
  const named = /filename="?([^";]+)"?/.exec(answer.headers.get("content-disposition") ?? "");
  return { blob: await answer.blob(), name: named?.[1] ?? `moveset.${format}` };
}
