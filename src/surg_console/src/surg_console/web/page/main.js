// The page: connects hand, socket, pictures and view.

import { Feel } from "./overlays/feel.js";
import { Marks } from "./overlays/marks.js";
import { PlanOverlay } from "./overlays/plan.js";
import { Scene } from "./overlays/scene.js";
import { Hand } from "./hand.js";
import { showHelp } from "./key_help.js";
import { element, mark, remember, set, sink, streamOf, toast, write } from "./kit.js";
import { Link, clock } from "./link.js";
import { Pace } from "./inputs/pace.js";
import { speakWhileTouched } from "./inputs/touch_frames.js";
import { PadPage } from "./pads/pad_page.js";
import { Pads } from "./pads/pads.js";
import { View, showAge } from "./view.js";

const INPUT_MS = 20; // the console holds the arm after 100 ms without one
const LEAST_S = 0.015; // between two inputs, whatever sends them
const SHOW_MS = 200; // figures for people, all together; states are shown at once
const AGE_EVERY = 2; // times that figures are shown

let view = null;
let softLimit = Infinity; // of the force at the tip [N]
let status = null;
let sequence = 0;
let lastSample = clock();
let shown = 0;
let lastHand = null;
const picture = { exposedUs: 0, drawn: [] };
const pace = new Pace();

const link = new Link(onMessage, lost);
const pads = new Pads(() => null, () => link.say("hidden", { why: "gamepad" }));
const padPage = new PadPage(pads, () => status?.phase === "driving" && (toast("Press Stop before you map a gamepad."), true));
const hand = new Hand(element("view"), press, (why) => link.say("hidden", { why }), pads);
hand.mayChange = mayChange;

// For measurements: the times of each drawn picture, and its age; where the hand is.
globalThis.surgConsole = { picture, link, hand, status: () => status };

// What a page shows over or beside the picture; off until somebody asks, and then closed again.
const marks = new Marks(element("marks"), toast);
const plan = new PlanOverlay(element("plan"), element("plan-note"));
const scene = new Scene(element("room"), (text) => write(element("scene-note"), text));
const feel = new Feel(
  () => pads.inUse,
  () => status?.phase === "driving" && mine(),
  () => softLimit,
);
Object.assign(globalThis.surgConsole, { marks, plan, scene, feel, pace });

// --- messages of the console ---

function onMessage(message) {
  if (message.say === "welcome") {
    view = new View(message);
    softLimit = message.limits.tip_force_soft;
    for (const button of element("overlays").children) {
      // That of a plan is there while a model server is.
      if (button.dataset.overlay !== "plan") button.hidden = !message.overlays?.includes(button.dataset.overlay);
    }
  }
  else if (message.say === "status" && view) onStatus(message);
  else if (message.say === "episodes" && view) view.episodes(message.episodes);
  else if (message.say === "refused") toast(message.why);
}

function onStatus(message) {
  const before = status;
  status = message;
  if (before?.phase === "driving" && message.phase !== "driving") hand.rest();
  if (message.scale !== null && document.activeElement !== element("scale")) {
    set(element("scale"), "value", String(message.scale));
    write(element("scale-value"), message.scale.toFixed(2));
  }
  view.note(message);
  if (message.phase !== before?.phase || message.headline !== before?.headline) show();
}

/** Figures change together: every change of the page, however small, costs a whole frame. */
function show() {
  if (status && view) view.show(status, link);
  if (lastHand) showHand(lastHand);
  if (shown % AGE_EVERY === 0) showAge(picture, link.offsetUs, pace.spacing);
  shown += 1;
}
setInterval(show, SHOW_MS);

/** Nothing on the page is live any more, and it knows nothing of the arm. */
function lost(why) {
  status = null;
  hand.rest();
  view?.lose();
  mark(document.body, "link", "lost");
  mark(document.body, "phase", "free");
  mark(document.body, "headline", "Fault");
  write(element("headline"), "No connection");
  write(element("sentence"), why);
  write(element("alarm"), `No connection. ${why}`);
  write(element("link"), "not connected");
  mark(element("link"), "tone", "bad");
}

// --- inputs of the hand ---

const mine = () => status !== null && view !== null && status.holder === view.page;

function mayChange() {
  const free = status?.phase !== "driving" || hand.held("clutch");
  if (!free) toast("Hold the clutch (Space) to switch between mouse and keys.");
  return free;
}

/** What the page does itself. */
const OWN = {
  hand: () => hand.use(hand.hand === "rate" ? "position" : "rate"),
  eyes: () => !element("eyes").hidden && watch({ stereo: !pictures.stereo }),
  size: () => watch({ half: !pictures.half }),
  marks: () => turnOverlay("marks"),
  plan: () => turnOverlay("plan"),
  scene: () => turnOverlay("scene"),
  feel: () => {
    const on = element("feel").getAttribute("aria-pressed") !== "true";
    sink(element("feel"), on);
    feel.turn(on);
  },
  side: () => turnSide(document.body.dataset.side !== "left"),
  help: () => showHelp(element("help").hidden),
  less_scale: () => slide("scale", -1),
  more_scale: () => slide("scale", 1),
  slower: () => slide("speed", -1),
  faster: () => slide("speed", 1),
};

/** Move a slider by steps, as its keys do. */
function slide(id, steps) {
  const slider = element(id);
  if (slider.disabled) return;
  if (steps > 0) slider.stepUp();
  else slider.stepDown();
  slider.dispatchEvent(new Event("input"));
}

function turnSide(left) {
  mark(document.body, "side", left ? "left" : "right");
  sink(element("side"), left);
}

function turnOverlay(what) {
  const button = document.querySelector(`[data-overlay="${what}"]`);
  if (button.hidden) return;
  const on = button.getAttribute("aria-pressed") !== "true";
  sink(button, on);
  if (what === "marks") marks.turn(on);
  else if (what === "plan") plan.turn(on);
  else {
    element("scene").hidden = !on;
    mark(document.body, "scene", on ? "on" : "off");
    scene.turn(on);
  }
}
for (const button of element("overlays").children) {
  button.addEventListener("click", () => press(button.dataset.overlay));
}
element("feel").addEventListener("click", () => press("feel"));
addEventListener("resize", () => scene.draw());

function press(button) {
  if (button === "stop") {
    showHelp(false);
    padPage.end();
  }
  if (button in OWN) OWN[button]();
  else if (button === "record") link.press(status?.record.on ? "record_stop" : "record");
  else link.press(button);
}

function speak() {
  const now = clock();
  if (now - lastSample < LEAST_S) return;
  const driving = mine() && ["starting", "driving"].includes(status.phase);
  if (driving && pace.input(now - lastSample, now)) watch({});
  const sample = hand.sample(Math.min(0.1, now - lastSample));
  lastSample = now;
  if (mine() && document.visibilityState === "visible") {
    sequence += 1;
    link.say("input", { seq: sequence, at: now, picture_us: picture.exposedUs, ...sample });
  }
  lastHand = sample;
}
setInterval(speak, INPUT_MS);

speakWhileTouched(speak);

function showHand(sample) {
  const driving = status?.phase === "driving";
  for (const name of ["clutch", "camera"]) sink(element(name), driving && sample[name]);
  for (const button of element("hands").children) sink(button, button.dataset.hand === sample.hand);
  const ours = sample.hand === "position" ? "Drag in the picture." : hand.padName || "Keyboard";
  set(element("pad-map"), "hidden", !hand.padName);
  const device = view?.leads === false ? "Another device moves the arm." : ours;
  write(element("device"), device);
  const grip = sample.grip;
  set(element("jaw").firstElementChild.style, "width", grip === null ? "0px" : `${grip * 100}%`);
  write(element("jaw-value"), grip === null ? "–" : `${Math.round(grip * 100)} %`);
}

// A tab that is hidden or closed holds the arm at once, before its silence is noticed.
document.addEventListener("visibilitychange", () => {
  if (document.visibilityState === "hidden") link.say("hidden", { why: "hidden" });
});
addEventListener("pagehide", () => link.say("hidden", { why: "closed" }));
document.addEventListener("freeze", () => link.say("hidden", { why: "hidden" }));

// --- buttons ---

const PRESSED = ["enable", "stop", "record", "policy", "guide-home", "take", "new-episode", "success", "failure", "discard"];
for (const id of PRESSED) {
  element(id).addEventListener("click", () => press(id.replace("-", "_")));
}
element("veil-enable").addEventListener("click", () => press("enable"));
// A finger holds a button down; a mouse, which is needed in the picture, switches it on and off.
for (const name of ["clutch", "camera"]) {
  const node = element(name);
  let touched = false;
  node.addEventListener("pointerdown", (event) => {
    touched = event.pointerType === "touch";
    if (touched && !node.disabled) hand.latched[name] = true;
  });
  node.addEventListener("pointerup", () => { if (touched) hand.latched[name] = false; });
  node.addEventListener("pointercancel", () => { if (touched) link.say("hidden", { why: "pointer" }); });
  node.addEventListener("click", () => { if (!touched) hand.latched[name] = !hand.latched[name]; });
}
for (const button of document.querySelectorAll("[data-key]")) {
  button.addEventListener("pointerdown", () => hand.keys.add(button.dataset.key));
  for (const end of ["pointerup", "pointerleave", "pointercancel"]) {
    button.addEventListener(end, () => hand.keys.delete(button.dataset.key));
  }
}
element("side").addEventListener("click", () => press("side"));
for (const id of ["help-open", "help-close"]) element(id).addEventListener("click", () => press("help"));
for (const button of element("hands").children) {
  button.addEventListener("click", () => hand.use(button.dataset.hand));
}
// A clicked button must not react to the space bar afterwards: that is the clutch.
addEventListener("click", (event) => event.target.closest("button")?.blur());
element("scale").addEventListener("input", ({ target }) => {
  element("scale-value").textContent = Number(target.value).toFixed(2);
  link.say("scale", { value: Number(target.value) });
});
element("speed").addEventListener("input", ({ target }) => {
  hand.speed = Number(target.value) / 1000;
  element("speed-value").textContent = `${target.value} mm/s`;
});
for (const id of ["scale", "speed"]) element(id).addEventListener("change", ({ target }) => target.blur());

// --- pictures ---

const canvas = element("picture").transferControlToOffscreen();
const worker = new Worker("/page/picture.js", { type: "module" });
const parameters = new URLSearchParams(location.search);
const pictures = { stereo: false, half: parameters.get("size") === "half" };
const layout = () => (pictures.stereo ? "stereo" : "left") + (pictures.half ? "_half" : "");
worker.postMessage({ canvas, settings: streamOf(layout()) }, [canvas]);
worker.onmessage = ({ data }) => {
  if (data.trouble) {
    toast(data.trouble);
    return;
  }
  remember(picture, data, link.offsetUs);
  marks.shown(data);
  plan.shown(data);
};

function watch(change) {
  Object.assign(pictures, change);
  worker.postMessage({ settings: { layout: layout(), spacing: pace.spacing } });
  for (const button of element("eyes").children) sink(button, (button.dataset.layout === "stereo") === pictures.stereo);
  for (const button of element("size").children) sink(button, (button.dataset.size === "half") === pictures.half);
}
for (const button of element("eyes").children) {
  button.addEventListener("click", () => watch({ stereo: button.dataset.layout === "stereo" }));
}
for (const button of element("size").children) {
  button.addEventListener("click", () => watch({ half: button.dataset.size === "half" }));
}
watch({});
turnSide(parameters.get("side") === "left");
