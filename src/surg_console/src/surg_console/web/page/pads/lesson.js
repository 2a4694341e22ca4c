// How a person maps a gamepad: each control is moved once and let go. Nothing here knows the page.

import { MOTIONS } from "./pads.js";

const JITTER = 0.05; // a value that changes less stands still
const STILL_S = 0.3;
const NEAR = 0.2; // of its value before
const FAR = 0.5; // a smaller way is not meant
const LARGEST_REST = 1.05; // beyond: a hat that tells its direction by one number

export const STEPS = [
  ["x", "Push the stick that moves the tip to the right, and let go."],
  ["y", "Pull the stick that moves the tip down, and let go."],
  ["z", "Push the stick that moves the tip deeper, and let go."],
  ["roll", "Push the stick that rolls the tip clockwise, and let go."],
  ["close", "Press what closes the jaw."],
  ["open", "Press what opens the jaw."],
  ["hold", "Press what you will hold to move: without it nothing moves."],
  ["clutch", "Press the clutch."],
  ["camera", "Press what moves the camera."],
  ["enable", "Press what enables the arm."],
  ["stop", "Press what stops the arm."],
  ["record", "Press what starts a recording."],
];

export class Lesson {
  /** @param id of the pad that is mapped */
  constructor(id) {
    this.id = id;
    this.step = 0;
    this.mapping = {};
    this.trouble = "";
    this.begin();
  }

  begin() {
    this.start = null; // values before the step
    this.last = null;
    this.since = 0;
  }

  get done() {
    return this.step === STEPS.length;
  }

  get sentence() {
    return this.done ? "" : `${this.trouble} ${STEPS[this.step][1]}`.trim();
  }

  /** Leave this control out. */
  skip() {
    this.step += 1;
    this.trouble = "";
    this.begin();
  }

  /** Look at the pad, `now` [s]. */
  feed(pad, now) {
    if (this.done) return;
    const values = [...pad.axes, ...pad.buttons.map((each) => each.value)];
    const still = this.last?.length === values.length && values.every((v, i) => !(Math.abs(v - this.last[i]) > JITTER));
    if (!still) [this.last, this.since] = [values, now];
    if (this.start === null && now - this.since >= STILL_S) {
      this.start = values;
      this.ways = values.map((v) => ({ low: v, high: v, lowBefore: v, highBefore: v }));
    }
    if (this.start === null) return;
    values.forEach((v, i) => widen(this.ways[i], v));
    if (now - this.since >= STILL_S) this.judge(values, pad.axes.length);
  }

  /**
   * Whatever went farthest and came back to where it was before. A trigger may say 0 until it is
   * touched for the first time: then its rest and its end are both far from what it said.
   */
  judge(values, axes) {
    const moved = values.map((rest, i) => {
      const { low, high, lowBefore, highBefore } = this.ways[i];
      const [end, before] = high - rest > rest - low ? [high, lowBefore] : [low, highBefore];
      const known = Math.abs(rest - this.start[i]) < NEAR || Math.abs(end - this.start[i]) > FAR;
      return { i, rest, end, way: known && Math.abs(rest - before) < NEAR ? Math.abs(end - rest) : 0 };
    }).filter(({ rest, way }) => way > FAR && Math.abs(rest) <= LARGEST_REST);
    if (!moved.length) return;
    const { i, rest, end } = moved.reduce((a, b) => (b.way > a.way ? b : a));
    const [name] = STEPS[this.step];
    if (i >= axes && MOTIONS.includes(name)) this.again("That is a button: a stick is needed.");
    else this.take(name, { [i < axes ? "axis" : "button"]: i < axes ? i : i - axes, rest, end });
  }

  take(name, source) {
    const same = ([, [other]]) => other.axis === source.axis && other.button === source.button;
    const clash = Object.entries(this.mapping).filter(same).find(([taken, [other]]) =>
      MOTIONS.includes(name) || MOTIONS.includes(taken)
      || Math.sign(other.end - other.rest) === Math.sign(source.end - source.rest));
    if (clash) {
      this.again(`That is in use for: ${clash[0]}.`);
      return;
    }
    this.mapping[name] = [source];
    this.skip();
  }

  again(why) {
    this.trouble = why;
    this.begin();
  }
}

/** Keep the ends of a way, and what the other end was when each was reached last. */
function widen(way, value) {
  if (value >= way.high - JITTER) {
    way.lowBefore = way.low;
    way.high = Math.max(way.high, value);
  }
  if (value <= way.low + JITTER) {
    way.highBefore = way.high;
    way.low = Math.min(way.low, value);
  }
}

/** A mapping as it was kept; null: it is none. */
export function readMapping(text) {
  try {
    const mapping = JSON.parse(text);
    const number = Number.isFinite;
    const good = Object.entries(mapping).every(([name, sources]) =>
      STEPS.some(([known]) => known === name) && sources.every(({ axis, button, rest, end }) =>
        Number.isInteger(axis ?? button) && number(rest) && number(end) && Math.abs(end - rest) > FAR));
    return good ? mapping : null;
  } catch {
    return null;
  }
}
