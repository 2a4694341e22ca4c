// Shows the console's status on the page; decides nothing.

import { showFixtures } from "./fixtures.js";
import { element, mark, set, sink, write } from "./kit.js";
import { wallUs } from "./link.js";

const OLD_PICTURE_MS = 150; // three of the endoscope's periods
const TREND_S = 30;
const TREND_STEP_S = 0.25; // between two points, each the largest value of its interval

/** One figure with its bar. */
class Gauge {
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
class Trend {
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
    const { width, height } = this.canvas;
    const largest = Math.max(...this.points.map((point) => point[1]));
    const full = Math.max(this.least, 1.25 * largest);
    context.clearRect(0, 0, width, height);
    context.fillStyle = "#202832";
    context.fillRect(0, height - 2, width, 2);
    context.fillStyle = "#6b7886";
    context.font = "20px system-ui, sans-serif";
    context.fillText(`${TREND_S} s, largest ${(largest * 1e3).toFixed(3)} mm`, 0, 18);
    context.beginPath();
    for (const [at, deviation] of this.points) {
      const x = width * (1 - (seconds - at) / TREND_S);
      context.lineTo(x, height - 2 - ((height - 4) * deviation) / full);
    }
    context.lineJoin = "round";
    context.strokeStyle = "#4fd1c5";
    context.lineWidth = 2;
    context.stroke();
  }
}

export class View {
  /** @param facts the console's welcome: cell, arm, views, limits. */
  constructor(facts) {
    const { limits } = facts;
    write(element("cell"), facts.cell);
    element("eyes").hidden = !facts.views.includes("right");
    this.gauges = {
      rcm: new Gauge("rcm", { unit: 1e3, digits: 3, full: limits.rcm_error_fault, warn: limits.rcm_error_warn, bad: limits.rcm_error_fault }),
      trocar: new Gauge("trocar", { unit: 1, digits: 1, full: limits.trocar_force_fault, warn: limits.trocar_force_warn, bad: limits.trocar_force_fault }),
      tip: new Gauge("tip", { unit: 1, digits: 1, full: limits.tip_force_hard, warn: limits.tip_force_soft, bad: limits.tip_force_hard }),
      depth: new Gauge("depth", { unit: 1e3, digits: 1, full: limits.depth_max, warn: null, bad: null }),
    };
    if (limits.clearance !== undefined) {
      const { clearance } = limits;
      element("clearance").hidden = false;
      this.gauges.clearance = new Gauge("clearance", { unit: 1e3, digits: 0, full: 10 * clearance, warn: 2 * clearance, bad: clearance, below: true });
    }
    this.trend = new Trend("trend", limits.rcm_error_warn / 20);
    this.page = facts.page;
    this.leads = facts.leads;
    this.plans = facts.overlays?.includes("plan"); // there is a picture to show a policy's plan in
    this.largest = null; // deviation since it was shown last
  }

  /** Called for every status, so that no peak is missed. */
  note(status) {
    const deviation = status.gauges.rcm_peak ?? status.gauges.rcm;
    this.trend.add(performance.now() / 1000, deviation);
    this.largest = deviation === null ? null : Math.max(this.largest ?? 0, deviation);
  }

  /** @param status of the console; `link` is the socket. */
  show(status, link) {
    const mine = status.holder === this.page;
    const { body } = document;
    mark(body, "phase", status.phase);
    mark(body, "headline", status.headline);
    write(element("headline"), mine ? status.headline : "Watching");
    const watching = status.holder ? `${status.holder} has control. Stop works from here too.` : status.sentence;
    write(element("sentence"), status.picture_problem || (mine ? status.sentence : watching));
    const values = { ...status.gauges, rcm: this.largest };
    for (const name in this.gauges) this.gauges[name].show(values[name]);
    this.largest = status.gauges.rcm;
    this.trend.draw();
    this.controls(status, mine);
    this.arms(status.arms, status.helpers);
    showFixtures(status.fixtures);
    write(element("task"), status.task);
    set(element("task"), "hidden", !status.task);
    const trip = link.roundTripMs;
    write(element("link"), trip === null ? "connected" : `connected, ${trip.toFixed(0)} ms`);
    mark(element("link"), "tone", "good");
  }

  controls(status, mine) {
    const control = element("control");
    write(control, mine ? "You have control" : status.holder ? `${status.holder} has control` : "No one has control");
    mark(control, "tone", mine ? "good" : "");
    set(element("take"), "hidden", mine);
    const driving = status.phase === "driving";
    const able = {
      enable: !driving && status.phase !== "starting",
      clutch: driving,
      camera: driving,
      record: true,
      scale: true,
      policy: status.policy.state !== "IDLE",
    };
    for (const id in able) set(element(id), "disabled", !mine || !able[id]);
    const veiled = mine && (status.phase === "held" || status.headline === "Fault");
    set(element("veil"), "hidden", !veiled);
    if (veiled) {
      write(element("veil-headline"), status.headline);
      write(element("veil-sentence"), status.sentence);
    }
    set(element("guide-home"), "hidden", !status.faulted_arms.length);
    set(element("state"), "hidden", veiled);
    const policy = element("policy");
    set(policy, "hidden", !status.policy.state);
    sink(policy, status.policy.on);
    set(policy, "title", status.policy.sentence);
    set(document.querySelector("[data-overlay=plan]"), "hidden", !status.policy.state || !this.plans);
    const record = element("record");
    sink(record, status.record.on);
    const word = status.record.finishing ? "Finishing …" : status.record.on ? "Stop recording" : "Record";
    write(record.querySelector("span"), word);
    set(record, "title", status.record.problem);
  }

  arms(arms, helpers) {
    const list = element("arms");
    while (list.children.length > arms.length + helpers.length) list.lastChild.remove();
    const row = (i) => list.children[i] ?? list.appendChild(armRow());
    arms.forEach((arm, i) => {
      const tones = { ENABLED: "good", PAUSED: "warn", FAULT: "bad", SILENT: "bad" };
      const word = `${arm.state || "no state"}${arm.homed ? "" : ", not homed"}`;
      const calm = arm.state === "ENABLED" && arm.homed;
      this.arm(row(i), arm.name, word, tones[arm.state], calm ? "" : arm.sentence);
    });
    helpers.forEach((hand, i) => {
      const tones = { FOLLOWING: "good", CLUTCHED: "warn", WAITING: "warn", FAULT: "bad" };
      this.arm(row(arms.length + i), hand.name, hand.state, tones[hand.state], hand.sentence);
    });
  }

  arm(row, name, state, tone, sentence) {
    write(row.querySelector("b"), name);
    const word = row.querySelector(".word");
    write(word, state);
    mark(word, "tone", tone ?? "");
    write(row.querySelector("p"), sentence);
  }

  episodes(entries) {
    const nothing = made("li", "quiet", "No recordings yet.");
    element("episodes").replaceChildren(...(entries.length ? entries.map(episodeRow) : [nothing]));
  }
}

function made(tag, className = "", textContent = "") {
  return Object.assign(document.createElement(tag), { className, textContent });
}

function armRow() {
  const row = made("li");
  row.append(made("b"), made("span", "chip word"), made("p"));
  return row;
}

function episodeRow(entry) {
  const row = made("li");
  const length = entry.seconds === null ? "" : `${entry.seconds.toFixed(1)} s`;
  const judged = entry.outcome === "complete" && entry.success !== null;
  const success = entry.success ? "success" : "no success";
  const outcome = made("span", "chip", judged ? success : entry.outcome);
  const good = entry.outcome === "complete" && entry.success !== false;
  outcome.dataset.tone = good ? "good" : entry.outcome === "unfinished" ? "" : "warn";
  row.title = entry.reason;
  row.append(made("span", "", entry.name), made("span", "quiet", length), outcome);
  return row;
}

/** Write how old the picture on the screen is, by its exposure, and how many come. */
export function showAge(picture, offsetUs) {
  const age = (wallUs() + offsetUs - picture.exposedUs) / 1000;
  const recent = picture.drawn.slice(-100).filter((each) => each.drawnUs > wallUs() - 2e6);
  const node = element("age");
  if (!picture.exposedUs) return;
  const middle = recent.map((each) => each.ageMs).sort((a, b) => a - b)[recent.length >> 1];
  const old = !recent.length || age > OLD_PICTURE_MS + (middle ?? 0);
  write(node, old ? `picture ${(age / 1000).toFixed(1)} s old` : `picture ${middle.toFixed(0)} ms old`);
  mark(node, "tone", old ? "bad" : "");
  const codec = picture.drawn.at(-1).codec === "h264" ? "H.264" : "JPEG";
  write(element("rate"), `${Math.round(recent.length / 2)} fps, ${codec}`);
}
