// The page /monitor: the stereo picture in the format of a 3D monitor. It is no page of the session:
// it moves nothing, and Stop is all that it can ask for.

import { FORMATS } from "./eyes.js";
import { element, mark, remember, sink, streamOf, write } from "./kit.js";
import { Link, wallUs } from "./link.js";

const SHIFT = 3.5; // [% of the width] 80 mm lies on the screen: f 451 px, eyes 4 mm apart, 640 px
const IDLE_MS = 3000;
const OLD_PICTURE_MS = 500;
const SHOW_MS = 500;

const address = new URLSearchParams(location.search);
// The choice belongs to this screen: it is kept in the address, which can be bookmarked.
const settings = {
  format: address.get("format") in FORMATS ? address.get("format") : "sbs",
  swap: address.get("swap") === "1",
  shift: Number.isFinite(parseFloat(address.get("shift"))) ? parseFloat(address.get("shift")) : SHIFT,
  test: false,
};
const picture = { exposedUs: 0, drawn: [] };
let status = null;
let facts = null;
let gone = "Connecting to the console.";

const worker = new Worker("/page/monitor_worker.js", { type: "module" });
const link = new Link(onMessage, (why) => { status = null; gone = why; show(); }, "/status");
globalThis.surgMonitor = { picture, settings, status: () => status };

// --- the console ---

function onMessage(message) {
  if (message.say === "welcome") {
    facts = message;
    const half = address.get("size") === "half" ? "_half" : "";
    worker.postMessage({ stream: streamOf((facts.views.includes("right") ? "stereo" : "left") + half) });
  }
  else if (message.say === "status") {
    const before = status;
    status = message;
    mark(document.body, "phase", message.phase);
    if (before?.phase !== message.phase || before?.headline !== message.headline) show();
  }
}

/** What stands in the picture: the state, whether the arm holds, and the picture's age. */
function show() {
  const age = (wallUs() + link.offsetUs - picture.exposedUs) / 1000;
  const old = !picture.exposedUs || age > OLD_PICTURE_MS;
  const oneEye = facts && !facts.views.includes("right");
  const recent = picture.drawn.slice(-20).map((each) => each.ageMs).sort((a, b) => a - b);
  const middle = recent[recent.length >> 1];
  let small = oneEye ? "Left eye only (both: ./surg teleop --cameras stereo). " : "";
  if (!picture.exposedUs) small += "No picture from the endoscope yet.";
  else small += old ? `Picture ${(age / 1000).toFixed(1)} s old` : `Picture ${middle.toFixed(0)} ms old`;
  const holds = !status || !["driving", "starting"].includes(status.phase);
  const headline = !status ? "No connection" : holds ? `HOLD · ${status.headline}` : status.headline;
  const sentence = status ? status.picture_problem || (holds ? status.sentence : "") : gone;
  write(element("alarm"), holds ? `${headline}. ${sentence}` : "");
  worker.postMessage({ text: { headline, sentence, small, holds, old } });
}
setInterval(show, SHOW_MS);

worker.onmessage = ({ data }) => {
  if (data.trouble) { gone = data.trouble; return; }
  remember(picture, data, link.offsetUs);
};

// --- the display ---

/** The canvas has the screen's physical pixels: rows and columns are those of the monitor. */
function size() {
  const packed = settings.format === "frame_packed";
  const canvas = element("screen");
  const width = packed ? 1920 : Math.round(innerWidth * devicePixelRatio);
  const height = packed ? 2205 : Math.round(innerHeight * devicePixelRatio);
  canvas.style.width = `${width / devicePixelRatio}px`;
  canvas.style.height = `${height / devicePixelRatio}px`;
  worker.postMessage({ size: [width, height] });
  advise();
}

/** What would spoil a format whose eyes lie on neighbouring pixels. */
function advise() {
  const fine = ["rows", "columns", "checker"].includes(settings.format);
  const packed = settings.format === "frame_packed";
  const scaled = devicePixelRatio !== 1;
  let text = "";
  if (fine && !document.fullscreenElement) text = "Rows need full screen (F), or an odd offset swaps the eyes.";
  else if (fine && scaled) text = "Set the browser's zoom and the desktop's scaling to 100 %.";
  else if (packed && innerHeight * devicePixelRatio !== 2205) text = "Frame packing needs a screen mode of 1920 × 2205.";
  write(element("advice"), text);
}

function apply() {
  const { format, swap, shift, test } = settings;
  element("format").value = format;
  element("shift").value = String(shift);
  write(element("shift-value"), `${shift.toFixed(1)} %`);
  sink(element("swap"), swap);
  sink(element("test"), test);
  worker.postMessage({ show: { format, swap, shift: shift / 100, test } });
  address.set("format", format);
  address.set("swap", swap ? "1" : "0");
  address.set("shift", shift.toFixed(1));
  history.replaceState(null, "", `?${address}${location.hash}`);
  size();
}

function change(what) {
  Object.assign(settings, what);
  settings.shift = Math.max(-2, Math.min(8, settings.shift));
  apply();
}

const ACTS = {
  KeyX: () => change({ swap: !settings.swap }),
  KeyT: () => change({ test: !settings.test }),
  KeyF: () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()),
  KeyS: () => link.press("stop"),
  Escape: () => link.press("stop"),
  BracketLeft: () => change({ shift: settings.shift - 0.1 }),
  BracketRight: () => change({ shift: settings.shift + 0.1 }),
};
Object.keys(FORMATS).forEach((format, i) => { ACTS[`Digit${i + 1}`] = () => change({ format }); });

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || !(event.code in ACTS)) return;
  event.preventDefault();
  wake();
  if (!event.repeat || event.code.startsWith("Bracket")) ACTS[event.code]();
});
for (const [format, name] of Object.entries(FORMATS)) {
  const number = Object.keys(FORMATS).indexOf(format) + 1;
  element("format").append(Object.assign(document.createElement("option"), { value: format, textContent: `${number} ${name}` }));
}
element("format").addEventListener("change", ({ target }) => { change({ format: target.value }); target.blur(); });
element("shift").addEventListener("input", ({ target }) => change({ shift: Number(target.value) }));
for (const [id, key] of [["swap", "KeyX"], ["test", "KeyT"], ["full", "KeyF"], ["stop", "KeyS"]]) {
  element(id).addEventListener("click", () => ACTS[key]());
}
addEventListener("resize", size);
document.addEventListener("fullscreenchange", size);

function wake() {
  mark(document.body, "idle", "false");
  clearTimeout(wake.timer);
  wake.timer = setTimeout(() => mark(document.body, "idle", "true"), IDLE_MS);
}
for (const kind of ["pointermove", "pointerdown", "focusin"]) addEventListener(kind, wake);
wake();

const canvas = element("screen").transferControlToOffscreen();
worker.postMessage({ canvas }, [canvas]);
apply();
show();
