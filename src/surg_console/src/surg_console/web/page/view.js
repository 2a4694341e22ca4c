// Shows the console's status on the page; decides nothing.

import { showFixtures } from "./fixtures.js";
import { Gauge, Trend } from "./gauges.js";
import { element, mark, set, sink, write } from "./kit.js";
import { wallUs } from "./link.js";

const OLD_PICTURE_MS = 150; // three of the endoscope's periods
const ALARMS = ["Held", "Fault"]; // headlines that are announced at once
const TONES = { success: "good", "not judged": "" };
const STOP_FULL = 0.05; // [m] of the bars that say how far the arm still goes: at the flange's full speed
const DRIFT_FULL = 0.005; // [m] of the bar that says how far instruments are seen beside their place

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
      stop_tip: new Gauge("stop-tip", { unit: 1e3, digits: 1, full: STOP_FULL, warn: null, bad: null }),
      stop_pivot: new Gauge("stop-pivot", { unit: 1e3, digits: 1, full: STOP_FULL, warn: null, bad: null }),
      drift: new Gauge("drift", { unit: 1e3, digits: 1, full: DRIFT_FULL, warn: null, bad: null }),
      depth: new Gauge("depth", { unit: 1e3, digits: 1, full: limits.depth_max, warn: null, bad: null }),
    };
    if (limits.clearance !== undefined) {
      const { clearance } = limits;
      element("clearance").hidden = false;
      this.gauges.clearance = new Gauge("clearance", { unit: 1e3, digits: 0, full: 10 * clearance, warn: 2 * clearance, bad: clearance, below: true });
    }
    this.trend = new Trend("trend", limits.rcm_error_warn / 20);
    this.page = facts.page;
    document.title = `${capital(facts.page)} · Operator console`;
    this.listed = []; // the recorded episodes
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
    mark(body, "link", "live");
    for (const id of ["main", "task", "judge"]) set(element(id), "inert", !element("help").hidden);
    set(element("stop"), "disabled", false);
    write(element("alarm"), ALARMS.includes(status.headline) ? `${status.headline}. ${status.sentence}` : "");
    mark(body, "phase", status.phase);
    mark(body, "headline", status.headline);
    write(element("headline"), mine ? status.headline : "Watching");
    const watching = status.holder ? `${status.holder} has control. Stop works from here too.` : status.sentence;
    write(element("sentence"), status.picture_problem || (mine ? status.sentence : watching));
    const values = { ...status.gauges, rcm: this.largest, drift: status.drift?.expected };
    for (const name in this.gauges) this.gauges[name].show(values[name]);
    this.largest = status.gauges.rcm;
    this.trend.draw();
    this.controls(status, mine);
    this.drift(status.drift);
    this.arms(status.arms, status.helpers);
    showFixtures(status.fixtures);
    this.task(status, mine);
    this.judge(status.record, mine);
    const trip = link.roundTripMs;
    write(element("link"), trip === null ? "connected" : `connected, ${trip.toFixed(0)} ms`);
    mark(element("link"), "tone", "good");
  }

  controls(status, mine) {
    const control = element("control");
    const who = mine ? "you have control" : status.holder ? `${status.holder} has control` : "no one has control";
    write(control, `${capital(this.page)}: ${who}`);
    mark(control, "tone", mine ? "good" : "");
    set(element("take"), "hidden", mine);
    set(element("take"), "disabled", false);
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

  /** The task's sentence, what to do now and next; at the end how it went. */
  task({ task, record }, mine) {
    set(element("task"), "hidden", !task);
    if (!task) return;
    write(element("task-sentence"), task.sentence);
    write(element("task-now"), task.ended || (task.now && `Now: ${task.now}`));
    mark(element("task-now"), "tone", task.ended ? (task.success ? "good" : "bad") : "");
    write(element("task-next"), task.next && `Next: ${task.next}`);
    set(element("new-episode"), "disabled", !mine || record.on);
  }

  /** Ask for a person's verdict on the recording that has stopped, until there is one. */
  judge(record, mine) {
    const entry = this.listed.find((each) => each.name === record.finished);
    const asked = entry !== undefined && !record.on && entry.outcome !== "" && entry.by !== "person";
    set(element("judge"), "hidden", !asked);
    if (!asked) return;
    const by = entry.by ? `, by the ${entry.by}` : "";
    write(element("judged"), `${entry.name} is recorded: ${entry.outcome}${by}. Your judgement:`);
    for (const id of ["success", "failure", "discard"]) set(element(id), "disabled", !mine);
  }

  /** Show that nothing is live. */
  lose() {
    for (const id of ["main", "task", "judge"]) set(element(id), "inert", true);
    for (const id of ["stop", "take"]) set(element(id), "disabled", true);
    set(element("veil"), "hidden", true);
    set(element("state"), "hidden", false);
    write(element("control"), `${capital(this.page)}: no control`);
    mark(element("control"), "tone", "");
    for (const name in this.gauges) this.gauges[name].show(null);
  }

  /** How far instruments are seen beside their place, and what nobody may trust any more. */
  drift(drift) {
    set(element("drift"), "hidden", !drift);
    if (!drift) return;
    mark(element("drift"), "tone", drift.refusal ? "bad" : "good");
    const known = drift.expected !== null;
    const mm = (value) => (1e3 * value).toFixed(1);
    write(element("drift-interval"), known ? `${mm(drift.least)} to ${mm(drift.most)}, 95 %` : "");
    write(element("drift-sentence"), drift.refusal || (known ? "" : drift.sentence));
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
    this.listed = entries;
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

/** The verdict's word; of the files only what is wrong with them. */
function episodeRow(entry) {
  const row = made("li");
  const length = entry.seconds === null ? "" : `${entry.seconds.toFixed(1)} s`;
  row.title = entry.reason;
  row.append(made("span", "", entry.name), made("span", "quiet", length));
  const chip = (words, tone) => mark(row.appendChild(made("span", "chip", words)), "tone", tone);
  if (entry.files !== "complete") chip(entry.outcome ? `files ${entry.files}` : entry.files, entry.files === "unfinished" ? "" : "warn");
  if (entry.outcome) chip(entry.outcome, TONES[entry.outcome] ?? "warn");
  return row;
}

function capital(text) {
  return text[0].toUpperCase() + text.slice(1);
}

/** Write how old the picture on the screen is, by its exposure, and how many come, `spacing` ms apart at least. */
export function showAge(picture, offsetUs, spacing) {
  const age = (wallUs() + offsetUs - picture.exposedUs) / 1000;
  const recent = picture.drawn.slice(-100).filter((each) => each.drawnUs > wallUs() - 2e6);
  const node = element("age");
  if (!picture.exposedUs) return;
  const middle = recent.map((each) => each.ageMs).sort((a, b) => a - b)[recent.length >> 1];
  const old = !recent.length || age > OLD_PICTURE_MS + spacing + (middle ?? 0);
  write(node, old ? `picture ${(age / 1000).toFixed(1)} s old` : `picture ${middle.toFixed(0)} ms old`);
  mark(node, "tone", old ? "bad" : "");
  const codec = picture.drawn.at(-1).codec === "h264" ? "H.264" : "JPEG";
  const fewer = spacing ? ": fewer, inputs go first" : "";
  write(element("rate"), `${Math.round(recent.length / 2)} fps, ${codec}${fewer}`);
  set(element("rate"), "title", fewer && "This page was late with an input, so it asks for fewer pictures.");
}
