// The line to the server: messages in, commands out, and another try whenever it is lost.

const FIRST_PAUSE_MS = 400, LONGEST_PAUSE_MS = 5000;
const TIMEOUT_MS = 10000; // the server says something every 3 s: after so long the line is dead, though nobody said so

async function inflate(data) {
  const stream = new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

const KINDS = { f4: Float32Array, i4: Int32Array, u1: Uint8Array };

// Reads what gridslam.live.protocol.encode wrote: {header, arrays}, each array with its shape.
export async function decode(data) {
  const buffer = await inflate(data);
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const arrays = {};
  let at = 4 + length;
  for (const [name, kind, shape] of header.arrays) {
    const count = shape.reduce((product, side) => product * side, 1);
    arrays[name] = new KINDS[kind](buffer, at, count);
    at += Math.ceil((count * KINDS[kind].BYTES_PER_ELEMENT) / 4) * 4;
  }
  return { header, arrays };
}

export class Connection {
  // `received` gets every message in its order; `changed` whether there is a connection, and why not.
  constructor(received, changed) {
    this.received = received;
    this.changed = changed;
    this.pause = FIRST_PAUSE_MS;
    this.open();
    setInterval(() => this.socket && performance.now() - this.lastMessageMs > TIMEOUT_MS && this.drop(), 1000);
    addEventListener("online", () => this.reconnect());
    document.addEventListener("visibilitychange", () => document.hidden || this.reconnect());
  }

  open() {
    const address = new URL("socket", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.search = location.search;
    address.hash = "";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    let queue = Promise.resolve();
    socket.onopen = () => {
      this.pause = FIRST_PAUSE_MS;
      this.changed(true, "");
    };
    this.lastMessageMs = performance.now();
    socket.onmessage = ({ data }) => {
      this.lastMessageMs = performance.now();
      queue = queue.then(() => decode(data)).then((message) => {
        if (this.socket !== socket) return;
        this.received(message);
        this.send({ do: "ack" });
      });
    };
    socket.onclose = ({ code, reason }) => this.socket === socket && this.lost(code, reason);
    this.socket = socket;
  }

  lost(code, reason) {
    this.socket = null;
    this.changed(false, code >= 4000 ? reason : "");
    this.timer = setTimeout(() => this.open(), this.pause);
    this.pause = Math.min(2 * this.pause, LONGEST_PAUSE_MS);
  }

  // Give a line up that is dead: closing it would wait for an answer.
  drop() {
    this.socket.close();
    this.lost(0, "");
  }

  // Try again at once: the network is back, or somebody looks again.
  reconnect() {
    if (this.socket) return;
    clearTimeout(this.timer);
    this.open();
  }

  send(command) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(command));
  }
}
