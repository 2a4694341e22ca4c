// Figures with a bar, and the deviation of the last half minute.

import { element, mark, set, write } from "./kit.js";

const TREND_S = 30;
const TREND_STEP_S = 0.25; // between two points, each the largest value of its interval

/** One figure with its bar. */
export class Gauge {
  /** `below`: small values are the bad ones. */
  constructor(id, { unit, digits, full, warn, bad, below = false }) {
    this.node = element(id);
    this.value = this.node.querySelector("b");
    this.bar = this.node.querySelector("i");
    this.tick = this.node.querySelector("em");
    Object.assign(this, { unit, digits, full, warn, bad, below });
    this.tick.hidden = warn === null;
    if (warn !== null) this.tick.style.left = `${(100 * warn) / full}%`;
  }

  show(value) {
    if (value === this.shown) return;
    this.shown = value;
    const known = value !== null && value !== undefined;
    write(this.value, known ? (value * this.unit).toFixed(this.digits) : "–");
    this.bar.style.width = known ? `${Math.max(0, Math.min(1, value / this.full)) * 100}%` : "0";
    const beyond = (limit) => known && limit !== null && (this.below ? value <= limit : value >= limit);
    mark(this.node, "tone", beyond(this.bad) ? "bad" : beyond(this.warn) ? "warn" : "good");
  }
}

/** The deviation during the last half minute, scaled to its largest value. */
export class Trend {
  constructor(id, least) {
    this.canvas = element(id);
    this.context = this.canvas.getContext("2d");
    this.least = least; // [m] full height at least
    this.points = [];
  }

  add(seconds, value) {
    if (value === null) return;
    this.peak = Math.max(this.peak ?? 0, value);
    if (seconds - (this.points.at(-1)?.[0] ?? 0) < TREND_STEP_S) return;
    this.points.push([seconds, this.peak]);
    this.peak = 0;
    while (this.points[0][0] < seconds - TREND_S) this.points.shift();
    this.stale = true;
  }

  /** Draw what has been added, if anything has. */
  draw() {
    if (!this.stale) return;
    this.stale = false;
    const seconds = this.points.at(-1)[0];
    const { context } = this;
    // As many pixels as the screen has there: a canvas that is stretched is read badly.
    const { clientWidth: width, clientHeight: height } = this.canvas;
    set(this.canvas, "width", Math.round(width * devicePixelRatio));
    set(this.canvas, "height", Math.round(height * devicePixelRatio));
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    const look = getComputedStyle(this.canvas);
    const largest = Math.max(...this.points.map((point) => point[1]));
    const full = Math.max(this.least, 1.25 * largest);
    context.clearRect(0, 0, width, height);
    context.fillStyle = look.getPropertyValue("--track");
    context.fillRect(0, height - 1, width, 1);
    context.fillStyle = look.getPropertyValue("--quiet");
    context.font = "11px system-ui, sans-serif";
    context.fillText(`${TREND_S} s, largest ${(largest * 1e3).toFixed(3)} mm`, 0, 10);
    context.beginPath();
    for (const [at, deviation] of this.points) {
      const x = width * (1 - (seconds - at) / TREND_S);
      context.lineTo(x, height - 1 - ((height - 2) * deviation) / full);
    }
    context.lineJoin = "round";
    context.strokeStyle = look.getPropertyValue("--accent");
    context.lineWidth = 1.5;
    context.stroke();
  }
}
