// Steer a stream of a moveset server from JavaScript; nothing to install. Browsers and Node 22 have WebSocket built in,
// Node 20 needs a flag:
//
//   node --experimental-websocket stream_client.mjs "a person walks forward" "a person waves" [take.bvh]

/** One packet: root positions and local quaternions (x y z w) of n frames, and which parts of the feet stand. */
export function parsePacket(buffer) {
  const view = new DataView(buffer);
  if (view.byteLength < 32 || view.getUint32(0, true) !== 0x5453564d || view.getUint16(4, true) !== 1)
    throw new Error("no packet of version 1");
  const [joints, frames] = [view.getUint16(6, true), view.getUint32(8, true)];
  const floats = frames * (3 + 4 * joints);
  const hasContacts = (view.getUint32(28, true) & 1) === 1;
  if (view.byteLength !== 32 + 4 * floats + (hasContacts ? 4 * frames : 0)) throw new Error("a packet is cut short");
  return {
    joints,
    frames,
    firstFrame: Number(view.getBigUint64(12, true)),
    fps: view.getFloat32(20, true),
    latencyMs: view.getFloat32(24, true),
    rows: new Float32Array(buffer, 32, floats), // little-endian machines only, as all that run browsers today
    contacts: hasContacts ? new Uint8Array(buffer, 32 + 4 * floats, 4 * frames) : null,
  };
}

/** Records prompts one after the other, `seconds` each; resolves to the packets; an error has those that came. */
export function record(server, prompts, seconds, log = console.log) {
  return new Promise((resolve, reject) => {
    if (typeof WebSocket === "undefined") throw new Error("this Node has no WebSocket; add --experimental-websocket");
    const socket = new WebSocket(server.replace(/^http/, "ws") + "/v1/stream");
    let packets = [];
    let next = 1;
    socket.binaryType = "arraybuffer";
    const fail = (message) => {
      socket.onmessage = socket.onerror = socket.onclose = null;
      socket.close();
      reject(Object.assign(new Error(message), { packets }));
    };
    const send = (message) => socket.send(JSON.stringify(message));
    socket.onopen = () => send({ type: "start", prompt: prompts[0], seed: 7 });
    const missing = `no server at ${server}; start one with: moveset serve`;
    socket.onerror = () => fail(packets.length ? "the server is gone" : missing);
    socket.onclose = () => fail("the server ended the stream");
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") {
        const event = JSON.parse(data);
        if (event.type === "error") fail(event.message);
        if (event.type === "prompt")
          log([`"${event.text}" from frame ${event.takes_effect_at} on`, ...event.warnings].join("; "));
        if (event.type === "segment") log(`segment ${event.segment}: made in ${event.latency_ms.toFixed(0)} ms`);
        return;
      }
      const packet = parsePacket(data);
      const made = packet.firstFrame + packet.frames;
      // With "commit" set, a new prompt takes frames back that were sent but not played: they come once more.
      packets = packets.filter((other) => parsePacket(other).firstFrame < packet.firstFrame).concat(data);
      send({ type: "played", frame: made }); // a player sends what it has shown
      if (made >= prompts.length * seconds * packet.fps) {
        resolve(packets);
        socket.onclose = null;
        socket.close();
      } else if (next < prompts.length && made >= next * seconds * packet.fps) {
        send({ type: "prompt", text: prompts[next++] });
      }
    };
  });
}

// In a page: import { record } from "./stream_client.mjs".
const script = typeof process !== "undefined" && process.argv[1];
if (script && import.meta.url === (await urlOf(script))) {
  const { access, writeFile } = await import("node:fs/promises");
  const { dirname } = await import("node:path");
  process.on("uncaughtException", ({ message }) => {
    console.error(message);
    process.exit(1);
  });
  const files = process.argv.slice(2).filter((word) => /\.\w+$/.test(word));
  const prompts = process.argv.slice(2).filter((word) => !files.includes(word));
  const server = (process.env.MOVESET_SERVER ?? "http://127.0.0.1:8765").replace(/\/$/, "");
  for (const file of files) await access(dirname(file)); // before anything is made that could not be kept
  // Whatever goes wrong, a stream cannot be had a second time.
  const keep = async (message, packets, file) => {
    const kept = file.replace(/\.\w+$/, ".mvst");
    await writeFile(kept, Buffer.from(await new Blob(packets).arrayBuffer()));
    throw new Error(`${message}; the packets are in ${kept}`);
  };
  if (prompts.length === 0) prompts.push("a person walks forward");
  const packets = await record(server, prompts, 4).catch(async (error) => {
    if (error.packets?.length && files.length) await keep(error.message, error.packets, files[0]);
    throw error;
  });
  for (const file of files) {
    const format = /(amass\.)?\w+$/i.exec(file)[0].toLowerCase();
    try {
      const reply = await fetch(`${server}/v1/export?format=${format}`, {
        method: "POST",
        headers: { "Content-Type": "application/octet-stream" },
        body: new Blob(packets),
      });
      const said = reply.ok ? null : await reply.json().catch(() => null);
      if (!reply.ok) throw new Error(said?.error?.message ?? `the server gave no file (${reply.status})`);
      await writeFile(file, Buffer.from(await reply.arrayBuffer()));
    } catch ({ message }) {
      await keep(message, packets, file);
    }
  }
}

/** A script's own address, whatever links lead to it. */
async function urlOf(path) {
  const [{ existsSync, realpathSync }, { pathToFileURL }] = await Promise.all([import("node:fs"), import("node:url")]);
  return existsSync(path) && pathToFileURL(realpathSync(path)).href;
}
