/** The WebSocket side: one object a stream, typed messages both ways. Knows nothing of the page. */
import type { SkeletonData } from "../skeleton";

export interface StartOptions {
  prompt: string;
  model: string | null;
  seed: number | null;
  steps: number | null;
  /** Seconds that the server may run ahead of what was played. */
  buffer: number;
  commit: number | null;
}

export interface Started {
  type: "started";
  model: string;
  seed: number;
  steps: number;
  fps: number;
  segment_frames: number;
  buffer: number;
  commit: number | null;
  skeleton: SkeletonData;
}

export interface Stage {
  text: string;
  takes_effect_at: number;
}

export type ServerMessage =
  | { type: "hello"; version: number }
  | Started
  | { type: "prompt"; text: string; takes_effect_at: number; stages: Stage[]; warnings: string[] }
  | { type: "segment"; segment: number; first_frame: number; frames: number; prompt: string; latency_ms: number }
  | { type: "paused" }
  | { type: "resumed" }
  | { type: "set" }
  | { type: "stopped"; frames: number; reason: string }
  | { type: "error"; code: string; message: string };

export type ClientMessage =
  | ({ type: "start" } & StartOptions)
  | { type: "prompt"; text: string }
  | { type: "pause" }
  | { type: "resume" }
  | { type: "played"; frame: number }
  | { type: "set"; buffer?: number; steps?: number }
  | { type: "stop" };

export interface StreamEvents {
  message(message: ServerMessage): void;
  packet(bytes: ArrayBuffer): void;
  /** `ended` says that the stream was over, or that the server told in an error why it closed the connection. */
  closed(ended: boolean): void;
}

/** Codes with which the server closes after an error message: idle or malformed, too large, busy. */
const TOLD = new Set([1008, 1009, 1013]);

/** A stream from its start to its end; a new one needs a new object. */
export class Stream {
  private readonly socket: WebSocket;
  private ended = false;

  constructor(start: StartOptions, events: StreamEvents, make: (url: string) => WebSocket = (url) => new WebSocket(url)) {
    const url = new URL("/v1/stream", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    this.socket = make(url.href);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => this.send({ type: "start", ...start });
    this.socket.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => {
      if (typeof data !== "string") return events.packet(data);
      const message = JSON.parse(data) as ServerMessage;
      events.message(message);
      if (message.type !== "stopped") return;
      this.ended = true;
      this.socket.close();
    };
    this.socket.onclose = ({ code }) => events.closed(this.ended || TOLD.has(code));
  }

  send(message: ClientMessage): void {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** End it: the server answers `stopped`; one that does not hear yet, or cannot answer any more, is let go of. */
  stop(): void {
    if (this.socket.readyState !== WebSocket.OPEN) return this.socket.close();
    this.send({ type: "stop" });
    setTimeout(() => this.socket.close(), 2000);
  }

  /** Leave at once, hearing nothing more. */
  abandon(): void {
    this.socket.onmessage = this.socket.onclose = this.socket.onopen = null;
    this.socket.close();
  }
}
