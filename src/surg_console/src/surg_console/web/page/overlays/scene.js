// The room beside the picture: every arm as capsules, drawn on a 2D canvas far to near. It is drawn
// when the arms have moved, and not at all while it is closed.

import { Feed } from "./feed.js";

const FOCAL = 1.4; // of the canvas' smaller side
const GRID_M = 0.1;
const GRID_HALF_M = 0.6;
const RADIANS_PER_PIXEL = 0.008;
const COLOURS = [[79, 209, 197], [122, 162, 247], [240, 180, 73], [187, 154, 247]];
const SHAFT_M = 0.012; // a thinner capsule is an instrument's

export class Scene {
  /** @param canvas on which the room is drawn; dragged, it turns. */
  constructor(canvas, note) {
    this.canvas = canvas;
    this.note = note;
    this.context = canvas.getContext("2d", { alpha: false });
    this.feed = new Feed("/scene", (message) => { this.scene = message; this.draw(); });
    this.scene = null;
    this.view = { turn: 0.9, lift: 0.45, away: 1.7 };
    this.drawn = 0; // for measurements
    this.spentMs = 0;
    this.drags();
  }

  turn(on) {
    this.feed.turn(on);
    if (on) this.draw();
  }

  drags() {
    const { canvas } = this;
    const at = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      at.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = at.get(event.pointerId);
      if (!before) return;
      at.set(event.pointerId, [event.clientX, event.clientY]);
      if (at.size > 1) this.zoom((event.clientY - before[1]) * 0.005);
      else this.orbit(event.clientX - before[0], event.clientY - before[1]);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => at.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY * 0.001);
    }, { passive: false });
  }

  orbit(x, y) {
    this.view.turn -= x * RADIANS_PER_PIXEL;
    this.view.lift = Math.max(-0.2, Math.min(1.5, this.view.lift + y * RADIANS_PER_PIXEL));
    this.draw();
  }

  zoom(by) {
    this.view.away = Math.max(0.2, Math.min(5, this.view.away * Math.exp(by)));
    this.draw();
  }

  draw() {
    const began = performance.now();
    const { canvas, context } = this;
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    if (!width || !height) return;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    context.fillStyle = "#0b0f13";
    context.fillRect(0, 0, width, height);
    const { arms = [], silent = [] } = this.scene ?? {};
    this.note(silent.length ? `${silent.join(", ")}: no joints` : "");
    if (!arms.length) return;
    const eye = new Eye(middle(arms), this.view, width, height);
    this.grid(eye);
    const bodies = arms.flatMap((arm, i) => bodiesOf(arm, COLOURS[i % COLOURS.length]));
    for (const body of bodies) body.seen = body.points.map((p) => eye.see(p));
    const depth = (body) => body.seen.reduce((sum, p) => sum + p[2], 0) / body.seen.length;
    bodies.sort((a, b) => depth(b) - depth(a));
    for (const body of bodies) this.body(body, eye);
    context.font = "12px system-ui, sans-serif";
    arms.forEach((arm, i) => {
      const [x, y, z] = eye.see(arm.capsules[0].slice(0, 3));
      context.fillStyle = css(COLOURS[i % COLOURS.length], 1);
      if (z > 0) context.fillText(arm.name, x + 14, y + 18);
    });
    this.drawn += 1;
    this.spentMs += performance.now() - began;
  }

  body({ seen, radius, colour, ring }, eye) {
    const { context } = this;
    if (seen.some((p) => p[2] < 0.02)) return; // behind the eye
    const [[x, y, z]] = seen;
    if (ring) {
      context.strokeStyle = css([255, 120, 255], 1);
      context.lineWidth = 2;
      context.beginPath();
      context.arc(x, y, 6, 0, 2 * Math.PI);
      context.stroke();
      return;
    }
    const [u, v, w] = seen[1];
    const wide = Math.max(1.5, (eye.focal * 2 * radius) / ((z + w) / 2));
    context.lineCap = "round";
    for (const [share, light] of [[1, 0.45], [0.8, 0.75], [0.4, 1]]) { // darker towards its edges
      context.strokeStyle = css(colour, light);
      context.lineWidth = wide * share;
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(u === x && v === y ? u + 0.01 : u, v);
      context.stroke();
    }
  }

  grid(eye) {
    const { context } = this;
    const [cx, cy] = eye.centre.map((v) => Math.round(v / GRID_M) * GRID_M);
    context.strokeStyle = "#1c242d";
    context.lineWidth = 1;
    context.beginPath();
    const line = (a, b) => {
      const [from, to] = [eye.see(a), eye.see(b)];
      if (from[2] < 0.05 || to[2] < 0.05) return;
      context.moveTo(from[0], from[1]);
      context.lineTo(to[0], to[1]);
    };
    for (let k = -GRID_HALF_M; k <= GRID_HALF_M + 1e-9; k += GRID_M) {
      line([cx + k, cy - GRID_HALF_M, 0], [cx + k, cy + GRID_HALF_M, 0]);
      line([cx - GRID_HALF_M, cy + k, 0], [cx + GRID_HALF_M, cy + k, 0]);
    }
    context.stroke();
  }
}

/** A pinhole that looks at the room's middle; z of the world is up. */
class Eye {
  constructor(centre, { turn, lift, away }, width, height) {
    this.centre = centre;
    this.focal = FOCAL * Math.min(width, height);
    this.middle = [width / 2, height / 2];
    const [c, s, cl, sl] = [Math.cos(turn), Math.sin(turn), Math.cos(lift), Math.sin(lift)];
    this.right = [-s, c, 0];
    this.ahead = [-c * cl, -s * cl, -sl];
    this.down = [c * sl, s * sl, -cl];
    this.away = away;
  }

  /** Pixel x, y and depth [m] of a point of the world. */
  see(point) {
    const d = point.map((v, i) => v - this.centre[i]);
    const dot = (axis) => axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2];
    const z = dot(this.ahead) + this.away;
    return [this.middle[0] + (this.focal * dot(this.right)) / z, this.middle[1] + (this.focal * dot(this.down)) / z, z];
  }
}

function middle(arms) {
  const points = arms.flatMap((arm) => arm.capsules.map((c) => c.slice(0, 3)));
  return [0, 1, 2].map((i) => {
    const values = points.map((p) => p[i]);
    return (Math.min(...values) + Math.max(...values)) / 2;
  });
}

function bodiesOf({ capsules, trocar }, colour) {
  const ring = { points: [trocar], radius: 0, colour, ring: true };
  return [ring, ...capsules.map(([ax, ay, az, bx, by, bz, radius]) => {
    const shade = radius < SHAFT_M ? [215, 222, 230] : colour;
    return { points: [[ax, ay, az], [bx, by, bz]], radius, colour: shade };
  })];
}

function css(colour, light) {
  return `rgb(${colour.map((v) => Math.round(v * light)).join(" ")})`;
}
