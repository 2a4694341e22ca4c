// How a person maps a gamepad: each control is moved once and let go. Nothing here knows the page.

import { direction, likeness, MOTIONS } from "./pads.js";

const JITTER = 0.05; // a value that changes less stands still
const STILL_S = 0.3;
const NEAR = 0.2; // of its value before
const FAR = 0.5; // a smaller way is not meant
const LARGEST_REST = 1.05; // beyond: a hat that tells its direction by one number
const HALF = 0.5;
const ZERO = 0.01; // a hat may say 0 at rest, or until it is touched

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
    this.hats = new Set(); // axes that are hats
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
      this.ways = values.map((v) => ({ low: v, high: v, lowBefore: v, highBefore: v, told: null, ofHat: true }));
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
      if (i < axes && this.isHat(i, rest)) {
        const { told } = this.ways[i];
        const pushed = told !== null && direction(rest) === null;
        return { way: pushed ? Infinity : 0, source: { axis: i, hat: told } };
      }
      const { low, high, lowBefore, highBefore } = this.ways[i];
      const [end, before] = high - rest > rest - low ? [high, lowBefore] : [low, highBefore];
      const known = Math.abs(rest - this.start[i]) < NEAR || Math.abs(end - this.start[i]) > FAR;
      const source = i < axes ? { axis: i, rest, end } : { button: i - axes, rest, end };
      return { way: known && Math.abs(rest - before) < NEAR ? Math.abs(end - rest) : 0, source };
    }).filter(({ way }) => way > FAR);
    if (!moved.length) return;
    const { source } = moved.reduce((a, b) => (b.way > a.way ? b : a));
    const [name] = STEPS[this.step];
    if ("button" in source && MOTIONS.includes(name)) this.again("That is a button: a stick is needed.");
    else this.take(name, source);
  }

  /** Whether an axis rests beyond every direction, or jumped from 0 to directions of a hat alone. */
  isHat(i, rest) {
    const { ofHat, between } = this.ways[i];
    if (Math.abs(rest) > LARGEST_REST || (ofHat && between)) this.hats.add(i);
    return this.hats.has(i);
  }

  take(name, source) {
    const clash = Object.entries(this.mapping).find(([taken, [other]]) => {
      const like = likeness(other, source); // a motion takes both ways
      return like > HALF || (like < -HALF && [name, taken].some((each) => MOTIONS.includes(each)));
    });
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

/**
 * Keep the ends of a way, and what the other end was when each was reached last. Of a hat: where it
 * was pushed last, diagonals left out, and whether the axis said nothing that a hat does not say.
 */
function widen(way, value) {
  const told = direction(value);
  if (told !== null && told % 2 === 0) way.told = told;
  way.between ||= told !== null && Math.abs(value) < 1 - JITTER;
  way.ofHat &&= told !== null || Math.abs(value) < ZERO;
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
      STEPS.some(([known]) => known === name) && sources.every(({ axis, button, hat, rest, end }) =>
        Number.isInteger(axis ?? button)
        && (Number.isInteger(hat) || (number(rest) && number(end) && Math.abs(end - rest) > FAR))));
    return good ? mapping : null;
  } catch {
    return null;
  }
}
