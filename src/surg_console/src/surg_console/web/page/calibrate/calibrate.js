// The page /calibrate: shows what the collector of views sees and needs; passes four requests on.
// It is on no socket that could move an arm.

import { element, mark, set, streamOf, toast, write } from "../kit.js";
import { Feed } from "../overlays/feed.js";

const KEYS = { Digit1: "stereo", Numpad1: "stereo", Digit2: "handeye", Numpad2: "handeye", KeyU: "undo", KeyS: "solve" };
const STEPS = { STEREO: "Both lenses", HANDEYE: "Hand-eye", NONE: "No step" };
const MOST_SOLUTIONS = 6;
const FINE_PX = 960; // least width of the overlay

const overlay = element("grid").getContext("2d");

let status = null;
const solutions = [];

// --- the collector ---

const feed = new Feed("/calibration", receive, ({ reason }) => {
  mark(element("link"), "tone", "bad");
  write(element("link"), "not connected");
  show({ running: false, hint: `${reason || "The console does not answer."} Start it again in its terminal; this page then connects by itself.` });
});

function receive(message) {
  if (message.say === "welcome") {
    write(element("cell"), message.cell);
    mark(element("link"), "tone", "good");
    write(element("link"), "connected");
  } else if (message.say === "calibration") show(message);
  else if (message.say === "refused") toast(message.why);
}

// --- what is shown ---

function show(message) {
  const before = status;
  status = message;
  const state = message.running ? message.state : "NONE";
  mark(document.body, "state", state);
  write(element("hint"), message.hint);
  mark(element("hint"), "tone", state === "DONE" || /^(View taken|Everything)/.test(message.hint) ? "good" : "");
  const collecting = state === "COLLECTING";
  for (const id of ["stereo", "handeye"]) set(element(id), "disabled", !message.running || state === "SOLVING");
  set(element("undo"), "disabled", !collecting || !message.views);
  set(element("solve"), "disabled", !collecting || !message.views);
  write(element("step"), message.running ? STEPS[message.step] : "No step");
  write(element("views"), message.running ? String(message.views) : "–");
  write(element("wanted"), message.wanted ? `of ${message.wanted}` : "");
  set(element("bar").style, "width", `${100 * (message.progress ?? 0)}%`);
  write(element("folder"), message.folder ?? "");
  list(element("missing"), message.missing ?? [], collecting ? "Nothing. Solving follows by itself." : "");
  list(element("result"), message.result ?? [], "");
  if (before?.state === "SOLVING" && state !== "SOLVING") solved(message);
  draw();
}

function list(node, texts, empty) {
  const wanted = texts.length ? texts : empty ? [empty] : [];
  if (node.dataset.shown === wanted.join("\n")) return;
  node.dataset.shown = wanted.join("\n");
  node.replaceChildren(...wanted.map((text) => Object.assign(document.createElement("li"), {
    textContent: text, className: texts.length ? "" : "met",
  })));
}

function solved(message) {
  const accepted = message.state === "DONE";
  solutions.unshift({ step: STEPS[message.step], views: message.views, accepted, residual: message.residual });
  solutions.length = Math.min(solutions.length, MOST_SOLUTIONS);
  element("solutions").replaceChildren(...solutions.map((each) => {
    const item = document.createElement("li");
    const what = Object.assign(document.createElement("span"), { textContent: `${each.step}, ${each.views} views` });
    const text = each.accepted ? `residual ${each.residual.toFixed(3)} px` : "refused";
    item.append(what, Object.assign(document.createElement("b"), {
      textContent: text, className: each.accepted ? "good" : "bad",
    }));
    return item;
  }));
}

/** The fields and the corners of the board, over the picture. */
function draw() {
  const { width, height } = overlay.canvas;
  overlay.clearRect(0, 0, width, height);
  if (!status?.running) return;
  const { columns, rows, fields, needed, corners } = status;
  const wide = width / columns, high = height / rows, gap = 3;
  overlay.font = `${Math.round(height / 26)}px system-ui, sans-serif`;
  fields.forEach((count, number) => {
    if (!count && !needed[number]) return;
    const x = (number % columns) * wide, y = Math.floor(number / columns) * high;
    overlay.lineWidth = height / 320;
    overlay.setLineDash(count ? [] : [height / 60, height / 60]);
    overlay.strokeStyle = count ? "rgb(79 209 197 / 80%)" : "rgb(240 180 73 / 95%)";
    overlay.fillStyle = count ? "rgb(79 209 197 / 13%)" : "transparent";
    overlay.fillRect(x + gap, y + gap, wide - 2 * gap, high - 2 * gap);
    overlay.strokeRect(x + gap, y + gap, wide - 2 * gap, high - 2 * gap);
    if (!count) return;
    overlay.fillStyle = "rgb(201 251 245 / 95%)";
    overlay.fillText(String(count), x + 3 * gap, y + high - 4 * gap);
  });
  overlay.setLineDash([]);
  overlay.fillStyle = "#fff200";
  for (let k = 0; k + 1 < corners.length; k += 2) {
    overlay.beginPath();
    overlay.arc(corners[k] * width, corners[k + 1] * height, height / 170, 0, 7);
    overlay.fill();
  }
}

// --- buttons and keys ---

function press(id) {
  if (!element(id).disabled) feed.say("calibrate", { request: element(id).dataset.request });
}

for (const id of new Set(Object.values(KEYS))) element(id).addEventListener("click", () => press(id));
addEventListener("keydown", (event) => {
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey || !(event.code in KEYS)) return;
  event.preventDefault();
  press(KEYS[event.code]);
});

// --- pictures ---

const canvas = element("picture").transferControlToOffscreen();
const worker = new Worker("/page/picture.js", { type: "module" });
worker.postMessage({ canvas, settings: streamOf("left") }, [canvas]);
const picture = { drawn: 0 };
worker.onmessage = ({ data }) => {
  if (data.trouble) {
    toast(data.trouble);
    return;
  }
  picture.drawn += 1;
  const finer = Math.max(1, Math.ceil(FINE_PX / data.width));
  if (overlay.canvas.width === finer * data.width && overlay.canvas.height === finer * data.height) return;
  overlay.canvas.width = finer * data.width;
  overlay.canvas.height = finer * data.height;
  draw();
};

// For tests.
globalThis.surgCalibrate = { picture, status: () => status, solutions };

show({ running: false, hint: "Connecting." });
feed.turn(true);
