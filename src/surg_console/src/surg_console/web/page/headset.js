// The page /headset: the console in a headset, by WebXR. The controllers are a leader like the mouse,
// with a dead-man; input goes out in the headset's frame, so a frame loop that stops is silence.

import { Feel } from "./overlays/feel.js";
import { HeadsetHand, rotate } from "./headset_hand.js";
import { RoomView } from "./headset_view.js";
import { element, mark, remember, streamOf, write } from "./kit.js";
import { Link, clock, wallUs } from "./link.js";

const SCREEN = { awayM: 1.2, widthM: 1.0 };
const ROOM_PX = { width: 640, height: 320 }; // of the canvas; the headset has a size of its own
const SHIFT = 0.035; // of the width: 80 mm lies on the screen (guide/screens/monitor.md)
const LEAST_S = 0.008; // between two inputs
const PULSE_S = 0.3; // between two pulses at a wall
const SHOW_S = 0.1; // between two looks at the lines below the screen
const FIGURES_S = 0.5; // between two figures in them: each change draws and loads the lines anew
const SECURE = "WebXR needs a secure page. By USB: adb reverse tcp:PORT tcp:PORT, then open "
  + "http://localhost:PORT/headset in the headset. By network: start the console with --tls and --token-file.";

const address = new URLSearchParams(location.search);

let facts = null;
let status = null;
let gone = "Connecting to the console.";
let xr = null; // the running session: {session, space, layer, view}
let screen = null; // {p, q} in the room; null: place it before the head
let waiting = null; // {image or planes, head}: the newest picture, not on the screen yet
let said = { at: 0, pulsed: 0, shown: 0, seq: 0, why: "" };
let figures = { at: -1, text: "" };
const picture = { exposedUs: 0, drawn: [] };

const link = new Link(onMessage, (why) => { status = null; gone = why; });
const hand = new HeadsetHand(press, recentre);
hand.byHead = address.get("scope") === "head";
globalThis.surgHeadset = { picture, link, status: () => status, sent: null, frames: 0 };
const feel = new Feel(
  () => (xr ? { vibrationActuator: hand.motor(xr.session) } : null),
  () => status?.phase === "driving" && mine() && surgHeadset.sent?.squeeze && !surgHeadset.sent.camera,
  () => facts.limits.tip_force_soft,
);

// --- the console ---

function onMessage(message) {
  if (message.say === "welcome") {
    facts = message;
    element("feel").parentElement.hidden = !message.overlays?.includes("feel");
    worker.postMessage({ stream: streamOf(stereo() ? "stereo" : "left") });
  } else if (message.say === "status") {
    status = message;
    mark(document.body, "phase", message.phase);
    if (mine()) said.why = "";
  } else if (message.say === "refused") said.why = message.why;
}

const stereo = () => facts?.views.includes("right") ?? false;
const mine = () => status !== null && facts !== null && status.holder === facts.page;

function press(button) {
  if (button === "enable" && !mine()) link.press("take");
  if (button === "record") link.press(status?.record.on ? "record_stop" : "record");
  else link.press(button);
}

/** The screen comes before the head again: directions change, so the arm holds. */
function recentre() {
  screen = null;
  link.say("hidden", { why: "recentred" });
}

// --- pictures ---

const worker = new Worker("/page/headset_worker.js", { type: "module" });
worker.onmessage = ({ data }) => {
  if (data.trouble) { said.why = data.trouble; return; }
  if (waiting) drop(waiting);
  waiting = data;
};

function drop({ image, head }) {
  image?.close();
  worker.postMessage({ shown: head });
}

function showNewest(view) {
  if (!waiting) return;
  const { head } = waiting;
  view.load(waiting, stereo() ? 2 : 1);
  drop(waiting);
  waiting = null;
  remember(picture, { ...head, drawnUs: wallUs() }, link.offsetUs);
}

// --- the headset ---

async function enter() {
  element("enter").disabled = true;
  try {
    // It gives the context only. In the page, the browser would draw it there too, at every frame.
    const canvas = Object.assign(document.createElement("canvas"), ROOM_PX);
    const gl = canvas.getContext("webgl2", { xrCompatible: true, alpha: false, antialias: false });
    if (!gl) throw new Error("This browser has no WebGL 2. Switch its hardware acceleration on, or use another browser.");
    const session = await navigator.xr.requestSession("immersive-vr", { requiredFeatures: ["local-floor"] });
    const layer = new XRWebGLLayer(session, gl);
    session.updateRenderState({ baseLayer: layer });
    const space = await session.requestReferenceSpace("local-floor");
    xr = { session, space, layer, view: new RoomView(gl, SCREEN.widthM, SHIFT) };
    screen = null;
    space.addEventListener("reset", recentre);
    session.addEventListener("visibilitychange", () => {
      if (session.visibilityState !== "visible") link.say("hidden", { why: "headset" });
    });
    session.addEventListener("end", ended);
    if (!mine()) link.press("take");
    session.requestAnimationFrame(onFrame);
    write(element("advice"), "Put the headset on.");
  } catch (error) {
    write(element("advice"), `No headset: ${error.message}`);
    element("enter").disabled = false;
  }
}

function ended() {
  link.say("hidden", { why: "headset" });
  xr = null;
  write(element("advice"), "The session has ended. The arm holds.");
  element("enter").disabled = false;
}

function onFrame(_time, frame) {
  if (!xr) return;
  xr.session.requestAnimationFrame(onFrame);
  surgHeadset.frames += 1;
  const pose = frame.getViewerPose(xr.space);
  if (!pose) return; // no place of the head: silence, and the arm holds
  screen ??= before(pose.transform);
  input(frame);
  showNewest(xr.view);
  const now = clock();
  if (now - said.shown > SHOW_S) {
    said.shown = now;
    xr.view.say(lines());
  }
  xr.view.draw(pose, xr.layer, screen);
}

/** The screen upright before the head. */
function before({ position, orientation }) {
  const { x, y, z, w } = orientation;
  const [ax, , az] = rotate([x, y, z, w], [0, 0, -1]);
  const half = Math.atan2(-ax, -az) / 2;
  const q = [0, Math.sin(half), 0, Math.cos(half)];
  const away = rotate(q, [0, 0, -SCREEN.awayM]);
  return { q, p: [position.x + away[0], position.y + away[1], position.z + away[2]] };
}

function input(frame) {
  const now = clock();
  if (now - said.at < LEAST_S) return;
  said.at = now;
  const sample = hand.sample(frame, xr.space, xr.session, screen, now);
  if (!mine() || xr.session.visibilityState !== "visible") return;
  said.seq += 1;
  link.say("input", { seq: said.seq, at: now, picture_us: picture.exposedUs, ...sample });
  surgHeadset.sent = sample;
  if (status.wall && sample.squeeze && now - said.pulsed > PULSE_S) {
    said.pulsed = now;
    hand.pulse(xr.session);
  }
}

function lines() {
  const age = (wallUs() + link.offsetUs - picture.exposedUs) / 1000;
  const holds = !status || !["driving", "starting"].includes(status.phase);
  const headline = status ? status.headline : "No connection";
  const tone = holds || headline !== "Following" ? "#f0b449" : "#4fd1c5";
  let words = status ? status.picture_problem || status.sentence : `${gone} The arm holds.`;
  if (status && !mine()) words = `${status.holder || "No page"} has control. A takes it if it is free. B stops.`;
  if (clock() - figures.at > FIGURES_S) {
    const rcm = status?.gauges.rcm;
    const deviation = rcm === null || rcm === undefined ? "" : `, RCM ${(rcm * 1000).toFixed(2)} mm`;
    const text = picture.exposedUs ? `picture ${Math.round(age)} ms old${deviation}` : "no picture yet";
    figures = { at: clock(), text };
  }
  const small = figures.text;
  return [
    [holds ? `HOLD · ${headline}` : headline, tone],
    [said.why || words, "#e4eaf0"],
    [stereo() ? small : `${small}; one eye only (./surg teleop --cameras stereo)`, age > 500 ? "#ff6161" : "#8794a3"],
  ];
}

// --- the page ---

async function look() {
  const port = location.port || (location.protocol === "https:" ? "443" : "80");
  let text = "";
  if (!isSecureContext) text = SECURE.replaceAll("PORT", port);
  else if (!navigator.xr) text = "This browser has no WebXR. Open this page in the headset's own browser, or in Chrome with a headset connected.";
  else if (!document.createElement("canvas").getContext("webgl2")) text = "This browser has no WebGL 2. Switch its hardware acceleration on, or use another browser.";
  else if (!(await navigator.xr.isSessionSupported("immersive-vr"))) text = "No headset is found. Connect one and reload, or open this page in the headset's own browser.";
  write(element("advice"), text || "Ready. Press Enter VR.");
  element("enter").disabled = text !== "";
}

element("enter").addEventListener("click", enter);
element("head").checked = hand.byHead;
element("feel").addEventListener("change", ({ target }) => feel.turn(target.checked));
element("head").addEventListener("change", ({ target }) => { hand.byHead = target.checked; });
element("stop").addEventListener("click", () => link.press("stop"));
addEventListener("keydown", ({ code }) => { if (code === "Escape") link.press("stop"); });
addEventListener("pagehide", () => link.say("hidden", { why: "closed" }));
look();
