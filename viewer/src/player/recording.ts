/** A canvas as a WebM video. */

const KINDS = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm"];

/** Whether this browser can. */
export function canRecord(): boolean {
  return kind() !== undefined;
}

function kind(): string | undefined {
  return typeof MediaRecorder === "undefined" ? undefined : KINDS.find((one) => MediaRecorder.isTypeSupported(one));
}

/** Records a canvas until `stop` is called; the video comes with `done`. */
export class Recording {
  readonly done: Promise<Blob>;
  private readonly recorder: MediaRecorder;

  constructor(canvas: HTMLCanvasElement, fps = 60) {
    const mimeType = kind();
    if (!mimeType) throw new Error("this browser cannot record WebM video");
    const stream = canvas.captureStream(fps);
    this.recorder = new MediaRecorder(stream, { mimeType, videoBitsPerSecond: 12_000_000 });
    const chunks: Blob[] = [];
    this.recorder.addEventListener("dataavailable", (event) => chunks.push(event.data));
    this.done = new Promise((resolve, reject) => {
      this.recorder.addEventListener("stop", () => {
        for (const track of stream.getTracks()) track.stop();
        resolve(new Blob(chunks, { type: "video/webm" }));
      });
      this.recorder.addEventListener("error", () => reject(new Error("the browser stopped recording")));
    });
    this.recorder.start();
  }

  stop(): void {
    if (this.recorder.state !== "inactive") this.recorder.stop();
  }
}

/** Offer bytes as a file of the reader's downloads. */
export function download(blob: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
