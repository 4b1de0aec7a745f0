// The connection to the server: receives messages, sends commands, and reconnects when lost.

const FIRST_PAUSE_MS = 400, LONGEST_PAUSE_MS = 5000;
const TIMEOUT_MS = 10000; // the server sends a message every 3 s: after this time the connection is regarded as lost

async function inflate(data) {
  const stream = new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

const KINDS = { f4: Float32Array, i4: Int32Array, u1: Uint8Array };

// Decodes a message of gridslam.live.protocol.encode: {header, arrays}.
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
  // `received` is called with each message in order; `changed` with whether there is a connection, and why not.
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

  // Drops a dead connection without waiting for the closing handshake.
  drop() {
    this.socket.close();
    this.lost(0, "");
  }

  // Reconnects at once: the network is back, or the page is visible again.
  reconnect() {
    if (this.socket) return;
    clearTimeout(this.timer);
    this.open();
  }

  send(command) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(command));
  }
}
