// A socket of values that are shown beside or over the picture; open while they are shown.

import { socketUrl, token } from "../link.js";

const AGAIN_MS = 1000;

export class Feed {
  /**
   * @param path "/marks", "/scene" or "/feel"
   * @param hear called with every message
   */
  constructor(path, hear) {
    this.path = path;
    this.hear = hear;
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
    socket.onopen = () => socket.send(JSON.stringify({ say: "hello", token: token() }));
    socket.onmessage = (event) => { if (this.socket === socket) this.hear(JSON.parse(event.data)); };
    socket.onclose = () => setTimeout(() => { if (this.socket === socket) this.connect(); }, AGAIN_MS);
  }
}
