// The socket of input and status. It reconnects by itself, which never moves anything: the console
// holds the arm whenever the socket ends.

const GOING_AWAY = 1001; // the close code of a console that ends
const SILENT = "The console does not answer.";
const AGAIN_MS = 1000;
const PING_MS = 1000;
const FIRST_PINGS = 12; // in quick succession, for the difference of the clocks
const FORGET_PINGS = 60; // clocks drift, so the best answer counts for a minute

/** Seconds on this page's own steady clock. */
export const clock = () => performance.now() / 1000;

/** Wall clock in microseconds. */
export const wallUs = () => (performance.timeOrigin + performance.now()) * 1000;

/** The token in the page's address, behind the #: browsers do not send it in requests. */
export function token() {
  return new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
}

/** Address of one of the console's sockets. */
export function socketUrl(path) {
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${path}`;
}

export class Link {
  /**
   * @param hear called with every message of the console; `closed` with why the socket ended
   * @param path "/control", or "/status" for a page that only watches
   */
  constructor(hear, closed, path = "/control") {
    this.path = path;
    this.offsetUs = 0; // console's wall clock less ours
    this.roundTripMs = null;
    this.hear = hear;
    this.closed = closed;
    this.socket = null;
    this.cell = "";
    this.why = SILENT; // the connection ended
    setInterval(() => this.ping(), PING_MS);
    this.connect();
  }

  get open() {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  connect() {
    const socket = new WebSocket(socketUrl(this.path));
    this.socket = socket;
    let opened = false;
    socket.onopen = () => {
      opened = true;
      this.pongs = 0;
      this.say("hello", { token: token() });
      this.ping();
    };
    socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (message.say === "welcome") this.cell = message.cell;
      if (message.say === "pong") this.pong(message);
      else this.hear(message);
    };
    socket.onclose = (event) => {
      if (event.reason || opened) this.why = event.reason || SILENT;
      const ended = event.code === GOING_AWAY || !event.reason;
      const again = ` Start it again in its terminal: ./surg teleop ${this.cell}. This page then connects by itself.`;
      this.closed(this.why + (ended ? again : ""));
      setTimeout(() => this.connect(), AGAIN_MS);
    };
  }

  ping() {
    this.say("ping", { at: clock() });
  }

  /** The quickest answer gives the best difference of the clocks. */
  pong(message) {
    const trip = clock() - message.at;
    this.roundTripMs = trip * 1000;
    if (this.pongs % FORGET_PINGS === 0) this.best = Infinity;
    this.pongs += 1;
    if (this.pongs < FIRST_PINGS) setTimeout(() => this.ping(), 50);
    if (trip > this.best) return;
    this.best = trip;
    this.offsetUs = message.wall_us - (wallUs() - (trip * 1e6) / 2);
  }

  say(what, keys = {}) {
    if (this.open) this.socket.send(JSON.stringify({ say: what, ...keys }));
  }

  press(button) {
    this.say("press", { button, at: clock() });
  }
}
