// The socket of input and status. It connects again by itself; that never moves anything, because
// the console lets go of the arm whenever the socket ends.

const AGAIN_MS = 1000;
const PING_MS = 1000;
const FIRST_PINGS = 12; // soon after the start, for the difference of the clocks
const FORGET_PINGS = 60; // clocks drift: the best answer counts for a minute

/** Seconds on this page's own steady clock. */
export const clock = () => performance.now() / 1000;

/** Wall clock in microseconds. */
export const wallUs = () => (performance.timeOrigin + performance.now()) * 1000;

/** What the address bar says behind #token=. It is never sent to the server in an address. */
export function token() {
  return new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
}

/** Address of one of the console's sockets. */
export function socketUrl(path) {
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${path}`;
}

export class Link {
  /** @param hear called with every message of the console; `closed` with why there is none. */
  constructor(hear, closed) {
    this.offsetUs = 0; // console's wall clock less ours
    this.roundTripMs = null;
    this.hear = hear;
    this.closed = closed;
    this.socket = null;
    setInterval(() => this.ping(), PING_MS);
    this.connect();
  }

  get open() {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  connect() {
    const socket = new WebSocket(socketUrl("/control"));
    this.socket = socket;
    socket.onopen = () => {
      this.pongs = 0;
      this.say("hello", { token: token() });
      this.ping();
    };
    socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (message.say === "pong") this.pong(message);
      else this.hear(message);
    };
    socket.onclose = (event) => {
      this.closed(event.reason || "The console does not answer. Reconnecting every second.");
      setTimeout(() => this.connect(), AGAIN_MS);
    };
  }

  ping() {
    this.say("ping", { at: clock() });
  }

  /** The quickest answer tells the difference of the clocks best. */
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
