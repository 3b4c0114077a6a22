// Asks the server for moments, one at a time, and decodes them.

/** Decodes a packet, as src/view/packet.rs writes it behind the number of dropped moments. */
export function decode(buffer) {
  const view = new DataView(buffer);
  const dropped = view.getUint32(0, true);
  const length = view.getUint32(4, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  const arrays = {};
  let at = 8 + length;
  for (const [name, count] of head.arrays) {
    arrays[name] = new Float32Array(buffer, at, count);
    at += 4 * count;
  }
  const image = head.size[0] > 0 ? new Blob([new Uint8Array(buffer, at)], { type: "image/jpeg" }) : null;
  return { ...head, ...arrays, image, dropped, bytes: buffer.byteLength };
}

/** Connection to the server that comes back by itself. */
export class Link {
  constructor(onAnswer, onState) {
    this.onAnswer = onAnswer;
    this.onState = onState;
    this.wanted = null;
    this.open();
  }

  open() {
    this.socket = new WebSocket(`ws://${location.host}/moments`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => {
      this.onState("");
      if (this.wanted) this.socket.send(JSON.stringify(this.wanted));
    };
    this.socket.onmessage = ({ data }) => {
      const wanted = this.wanted;
      this.wanted = null;
      this.onAnswer(typeof data === "string" ? JSON.parse(data) : decode(data), wanted);
    };
    this.socket.onclose = () => {
      this.onState("The server is gone, or has too many pages open; trying again.");
      setTimeout(() => this.open(), 1000);
    };
  }

  /** Asks for a moment, in place of one that is under way; its answer, too, is delivered. */
  ask(wanted) {
    this.wanted = wanted;
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(wanted));
  }
}
