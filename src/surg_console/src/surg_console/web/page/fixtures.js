// Draws the driven arm's virtual fixtures: the trocar's frame from two sides, with shaft and tip.

import { element, mark, set, write } from "./kit.js";

const HALF_M = 0.09; // shown to either side of the trocar
const DEPTH_M = 0.24; // shown below it
const NEAR_M = 0.001; // a wall counts as touched
const KEEP_OUT = "#e5665a";
const STAY_IN = "#4fd1c5";

/** @param fixtures of the status: tip and regions in the trocar frame [m], or null. */
export function showFixtures(fixtures) {
  const card = element("fixtures-card");
  set(card, "hidden", !fixtures);
  if (!fixtures) return;
  const canvas = element("fixtures");
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, canvas.width, canvas.height);
  drawSide(context, 0, canvas, fixtures, 0, "x");
  drawSide(context, canvas.width / 2, canvas, fixtures, 1, "y");
  list(fixtures.regions);
}

/** One side: an axis across the shaft to the right, z (into the patient) down. */
function drawSide(context, left, canvas, { tip, regions }, axis, label) {
  const width = canvas.width / 2;
  const scale = Math.min(width / (2 * HALF_M), (canvas.height - 12) / DEPTH_M);
  const at = (p) => [left + width / 2 + scale * p[axis], 10 + scale * p[2]];
  context.save();
  context.beginPath();
  context.rect(left, 0, width - 2, canvas.height);
  context.clip();
  for (const region of regions) drawRegion(context, region, axis, at, scale, tip);
  context.strokeStyle = "#c3cdd8";
  context.lineWidth = 3;
  line(context, at([0, 0, 0]), at(tip));
  context.fillStyle = "#ffffff";
  context.beginPath();
  context.arc(...at(tip), 5, 0, 2 * Math.PI);
  context.fill();
  context.fillStyle = "#6b7886";
  context.font = "20px system-ui, sans-serif";
  context.fillText(label, left + width - 22, 20);
  context.restore();
}

function drawRegion(context, region, axis, at, scale, tip) {
  const color = region.side === "keep_out" ? KEEP_OUT : STAY_IN;
  context.strokeStyle = context.fillStyle = color;
  context.globalAlpha = region.side === "keep_out" ? 0.5 : 0.25;
  context.lineCap = "round";
  if (region.shape === "plane") {
    drawPlane(context, region, axis, at, tip);
  } else if (region.shape === "sphere") {
    context.beginPath(); // browsers draw nothing for a line of no length
    context.arc(...at(region.point), region.radius * scale, 0, 2 * Math.PI);
    context.fill();
  } else {
    const end = region.point.map((x, i) => x + region.axis[i]);
    context.lineWidth = 2 * region.radius * scale;
    line(context, at(region.point), at(end));
  }
  context.globalAlpha = 1;
}

/** Where the plane cuts the side's plane through the tip; little strokes lie inside the region. */
function drawPlane(context, region, axis, at, tip) {
  const n = region.axis;
  const across = Math.hypot(n[axis], n[2]);
  if (across < 1e-3) return;
  const along = [n[2] / across, -n[axis] / across];
  const inward = [n[axis] / across, n[2] / across];
  const off = region.point.reduce((sum, x, i) => sum + n[i] * (x - tip[i]), 0) / across;
  const place = (t, into) => {
    const p = [0, 0, tip[2] + (off + into) * inward[1] + t * along[1]];
    p[axis] = tip[axis] + (off + into) * inward[0] + t * along[0];
    return at(p);
  };
  context.lineWidth = 3;
  line(context, place(-1, 0), place(1, 0));
  for (let t = -0.3; t <= 0.3; t += 0.01) line(context, place(t, 0), place(t + 0.004, 0.006));
}

function line(context, from, to) {
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
}

function list(regions) {
  const rows = element("fixtures-list");
  while (rows.children.length > regions.length) rows.lastChild.remove();
  regions.forEach((region, i) => {
    const row = rows.children[i] ?? rows.appendChild(made());
    write(row.querySelector("b"), region.name);
    const word = row.querySelector(".word");
    const part = region.of === "shaft" ? ", shaft" : "";
    write(word, `${region.side.replace("_", " ")}${part}: ${(region.distance * 1e3).toFixed(1)} mm`);
    mark(word, "tone", region.distance < -NEAR_M ? "bad" : region.distance < NEAR_M ? "warn" : "good");
  });
}

function made() {
  const row = document.createElement("li");
  row.append(document.createElement("b"), Object.assign(document.createElement("span"), { className: "chip word" }));
  return row;
}
