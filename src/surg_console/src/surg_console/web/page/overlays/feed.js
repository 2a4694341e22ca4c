// A socket of values that are shown beside or over the picture; open while they are shown.

import { socketUrl, token } from "../link.js";

const AGAIN_MS = 1000;

export class Feed {
  /**
   * @param path "/marks", "/scene", "/feel" or "/calibration"
   * @param hear called with every message; `closed` with the event of a socket that ended
   */
  constructor(path, hear, closed = () => {}) {
    this.path = path;
    this.hear = hear;
    this.closed = closed;
    this.socket = null;
  }

  turn(on) {
    if (on === (this.socket !== null)) return;
    if (on) this.connect();
    else {
      const socket = this.socket;
      this.socket = null;
      socket.close();
    }
  }

  connect() {
    const socket = new WebSocket(socketUrl(this.path));
    this.socket = socket;
    socket.onopen = () => this.say("hello", { token: token() });
    socket.onmessage = (event) => { if (this.socket === socket) this.hear(JSON.parse(event.data)); };
    socket.onclose = (event) => {
      this.closed(event);
      setTimeout(() => { if (this.socket === socket) this.connect(); }, AGAIN_MS);
    };
  }

  say(what, keys) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ say: what, ...keys }));
  }
}
