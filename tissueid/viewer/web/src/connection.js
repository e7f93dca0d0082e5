// The websocket: connects again by itself, answers every frame, and knows how old the newest sample is.

import { readHead } from "./frames.js";

const FIRST_PAUSE_MS = 300;
const LONGEST_PAUSE_MS = 3000;
// a connection that brings nothing for so long is closed from here; the server sends 100 frames a second
const SILENCE_MS = 4000;
// a clock is compared anew over this many frames: the machines' clocks drift
const OFFSET_FRAMES = 600;

export class Connection {
  /** hears: { hello, frame(buffer, head), status, state(word, sentence, why) } */
  constructor(hears) {
    this.hears = hears;
    this.pauseMs = FIRST_PAUSE_MS;
    this.frames = 0;
    this.dropped = 0;
    this.ended = false;
    this.offsets = [Infinity, Infinity];
    setInterval(() => this.watch(), 1000);
    this.open();
  }

  open() {
    const address = new URL(`ws${location.search}`, location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    this.hears.state("connecting", "connecting");
    const socket = new WebSocket(address);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    this.frames = 0;
    this.heardMs = performance.now();
    socket.onmessage = (event) => this.hear(event.data);
    socket.onclose = (event) => this.lost(event);
  }

  hear(data) {
    this.heardMs = performance.now();
    if (typeof data === "string") {
      const message = JSON.parse(data);
      if (message.type === "hello") {
        this.pauseMs = FIRST_PAUSE_MS;
        this.ended = false;
        this.offsets = [Infinity, Infinity];
        this.hears.hello(message);
        this.hears.state("live", "connected");
      } else this.hears.status(message);
      return;
    }
    const head = readHead(data);
    if (head === null) return this.socket.close(4000, "not a frame of this version");
    this.frames += 1;
    this.dropped = head.dropped;
    this.ended = head.ended;
    // the least delay seen is taken for the way alone, and half of the shortest way there and back for it
    this.offsets[1] = Math.min(this.offsets[1], this.heardMs / 1000 - head.nowS);
    if (this.frames % OFFSET_FRAMES === 0) this.offsets = [this.offsets[1], Infinity];
    this.hears.frame(data, head);
    this.say({ answer: this.frames });
  }

  /** The source's clock now [s]. */
  nowS() {
    return performance.now() / 1000 - Math.min(...this.offsets);
  }

  say(words) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ v: 1, ...words }));
  }

  watch() {
    const silent = performance.now() - this.heardMs > SILENCE_MS;
    if (silent && !this.ended && this.frames > 0 && !this.standsStill && this.socket.readyState === WebSocket.OPEN)
      this.socket.close(4001, "nothing came");
  }

  lost(event) {
    const why = event.reason || "the session is not served at this address any more, or its token changed";
    this.hears.state("lost", "not connected", `${why}; trying again`);
    const refused = event.code >= 1002 && event.code <= 1009 && event.code !== 1006 && event.code !== 1005;
    setTimeout(() => this.open(), refused ? LONGEST_PAUSE_MS : this.pauseMs);
    this.pauseMs = Math.min(this.pauseMs * 1.5, LONGEST_PAUSE_MS);
  }
}
