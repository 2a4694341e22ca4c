// What a policy plans and sees, over the picture: the planned way of each tip, the points and the map
// that it says it sees, and in words its phase, its confidence and what was refused. A layer of its
// own that changes only when a plan comes, at most 20 times a second.

import { Feed } from "./feed.js";

const OLD_MS = 1000; // without a new plan, after which nothing is drawn
const NONE = "No policy runs, so there is no plan.";
const WAY = "#ffb020";
const POINT = "#39d0ff";
const MOST = 64; // places of a way, and points, that are drawn

export class PlanOverlay {
  /**
   * @param canvas that lies over the picture
   * @param note element for the words
   */
  constructor(canvas, note) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.note = note;
    this.feed = new Feed("/plan", (message) => this.arrived(message));
    this.head = null; // of the picture on the screen
    this.plan = null;
    this.drawn = 0; // times
    this.on = false;
  }

  turn(on) {
    this.on = on;
    this.canvas.hidden = this.note.hidden = !on;
    this.plan = null;
    this.feed.turn(on);
    clearTimeout(this.timer);
    this.draw();
  }

  arrived(message) {
    this.plan = message;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => { this.plan = null; this.draw(); }, OLD_MS);
    this.draw();
  }

  /** A picture has been drawn. */
  shown(head) {
    const same = this.head && head.width === this.head.width && head.height === this.head.height;
    this.head = head;
    if (this.on && !same) this.draw();
  }

  draw() {
    if (!this.on) return;
    this.words();
    const { canvas, context, head, plan } = this;
    if (!head) return;
    canvas.width = head.width; // clears it
    canvas.height = head.height;
    if (!plan) return;
    this.drawn += 1;
    const eye = head.width > 2 * head.height ? head.width / 2 : head.width; // the left one
    const scale = head.height / 480;
    context.save();
    context.beginPath();
    context.rect(0, 0, eye, head.height);
    context.clip();
    const at = ([x, y]) => [x * eye, y * head.height];
    if (plan.attention) drawMap(context, plan.attention, eye, head.height);
    for (const path of plan.paths) drawWay(context, path.points.slice(0, MOST), at, scale);
    for (const point of plan.keypoints.slice(0, MOST)) drawPoint(context, point, at, scale);
    context.restore();
  }

  words() {
    this.note.replaceChildren(...lines(this.plan).map(([kind, text]) => {
      const line = document.createElement("p");
      line.dataset.kind = kind;
      line.textContent = text;
      return line;
    }));
  }
}

/** What is said in words: [kind, text] for each line. */
export function lines(plan) {
  if (!plan) return [["quiet", NONE]];
  const sure = plan.confidence === null ? "" : `${Math.round(100 * plan.confidence)} % sure`;
  const said = [plan.phase, sure].filter(Boolean).join(", ");
  const { rejected, clipped, late, stale } = plan.counts;
  const found = [];
  if (said) found.push(["said", said]);
  found.push([rejected ? "bad" : "quiet", `refused ${rejected}, clipped ${clipped}, late ${late}, stale ${stale}`]);
  if (plan.rule) found.push(["bad", `last refused by ${plan.rule}: ${plan.text}`]);
  if (plan.note) found.push(["quiet", plan.note]);
  return found;
}

function drawMap(context, { rows, columns, area, data }, width, height) {
  const bytes = Uint8Array.from(atob(data), (each) => each.charCodeAt(0));
  const map = new ImageData(columns, rows);
  for (let i = 0; i < rows * columns; i += 1) map.data.set([57, 208, 255, bytes[i] * 0.35], 4 * i);
  const small = new OffscreenCanvas(columns, rows);
  small.getContext("2d").putImageData(map, 0, 0);
  const [left, top, right, bottom] = area;
  context.drawImage(small, left * width, top * height, (right - left) * width, (bottom - top) * height);
}

function drawWay(context, points, at, scale) {
  context.strokeStyle = context.fillStyle = WAY;
  context.lineWidth = 1.5 * scale;
  context.beginPath();
  let down = false;
  for (const point of points) {
    if (!point) down = false;
    else if (down) context.lineTo(...at(point));
    else {
      context.moveTo(...at(point));
      down = true;
    }
  }
  context.stroke();
  points.forEach((point, n) => {
    if (!point) return;
    context.beginPath();
    context.arc(...at(point), (n === points.length - 1 ? 4 : 2) * scale, 0, 2 * Math.PI);
    context.fill();
  });
}

function drawPoint(context, { name, at: place, certainty }, at, scale) {
  const [x, y] = at(place);
  context.globalAlpha = 0.35 + 0.65 * certainty;
  context.strokeStyle = POINT;
  context.lineWidth = 1.5 * scale;
  context.beginPath();
  context.arc(x, y, 7 * scale, 0, 2 * Math.PI);
  context.stroke();
  context.font = `${Math.round(12 * scale)}px system-ui, sans-serif`;
  context.lineWidth = 3 * scale;
  context.strokeStyle = "#000a";
  context.fillStyle = POINT;
  const text = `${name} ${Math.round(100 * certainty)} %`;
  context.strokeText(text, x + 10 * scale, y - 6 * scale);
  context.fillText(text, x + 10 * scale, y - 6 * scale);
  context.globalAlpha = 1;
}
