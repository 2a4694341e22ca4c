// Marks of the instruments over the picture: where joints and calibration put them, each on the very
// picture that it belongs to. A picture whose marks have not come has none: older ones would lie.

import { Feed } from "./feed.js";

const KEPT = 20; // marks that wait for their picture
const LATE_MS = 1500; // without marks, after which the page says so
const COLOURS = { tip: "#00ffff", shaft: "#50ff50", jaw: "#ffff00", trocar: "#ff78ff" };
const NONE = "No marks arrive. Start with ./surg teleop --cameras marks, or ./surg up CELL --cameras marks.";

export class Marks {
  /**
   * @param canvas that lies over the picture
   * @param tell called with what a person should know
   */
  constructor(canvas, tell) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.tell = tell;
    this.feed = new Feed("/marks", (message) => this.arrived(message));
    this.byStamp = new Map(); // exposure stamp [us] -> marks
    this.head = null; // of the picture on the screen
    this.drawn = null; // stamp of the marks on the screen
    this.on = false;
  }

  turn(on) {
    this.on = on;
    this.canvas.hidden = !on;
    this.byStamp.clear();
    this.wipe();
    this.feed.turn(on);
    clearTimeout(this.timer);
    if (on) this.timer = setTimeout(() => { if (!this.byStamp.size) this.tell(NONE); }, LATE_MS);
  }

  arrived(message) {
    this.byStamp.set(message.exposed_us, message);
    if (this.byStamp.size > KEPT) this.byStamp.delete(this.byStamp.keys().next().value);
    if (message.exposed_us === this.head?.exposedUs) this.draw();
  }

  /** A picture has been drawn. */
  shown(head) {
    this.head = head;
    if (this.on) this.draw();
  }

  wipe() {
    if (this.drawn === null) return;
    this.drawn = null;
    this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
  }

  draw() {
    const { canvas, context, head } = this;
    const found = this.byStamp.get(head?.exposedUs);
    if (!found) {
      this.wipe();
      return;
    }
    if (canvas.width !== head.width || canvas.height !== head.height) {
      canvas.width = head.width;
      canvas.height = head.height;
    } else context.clearRect(0, 0, canvas.width, canvas.height);
    this.drawn = head.exposedUs;
    const scale = head.height / found.height;
    const eye = found.width * scale;
    const stereo = head.width > 1.5 * eye;
    for (const mark of found.marks) {
      if (mark.eye === "right" && !stereo) continue;
      const left = mark.eye === "right" ? eye : 0;
      context.save();
      context.beginPath();
      context.rect(left, 0, eye, head.height); // nothing reaches into the other eye
      context.clip();
      context.translate(left, 0);
      context.scale(scale, scale);
      context.translate(0.5, 0.5); // a pixel's middle
      drawMark(context, mark, 1.5 / scale);
      context.restore();
    }
  }
}

function drawMark(context, { name, points, ellipse }, width) {
  const known = points.filter(Boolean);
  if (!known.length) return;
  const [x, y] = known[0];
  context.strokeStyle = COLOURS[name] ?? "#fff";
  context.lineWidth = width;
  context.beginPath();
  if (points.length > 1) for (const point of known) context.lineTo(...point);
  else if (name === "trocar") context.arc(x, y, 6, 0, 2 * Math.PI);
  else {
    context.moveTo(x - 5, y);
    context.lineTo(x + 5, y);
    context.moveTo(x, y - 5);
    context.lineTo(x, y + 5);
    if (ellipse && ellipse[0] < 1e4) {
      const [long, short, angle] = ellipse;
      context.moveTo(x + long * Math.cos(angle), y + long * Math.sin(angle));
      context.ellipse(x, y, long, short, angle, 0, 2 * Math.PI);
    }
  }
  context.stroke();
}
