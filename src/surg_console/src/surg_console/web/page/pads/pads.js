// What gamepads say: how far each control is moved, and what is held. Nothing here knows the page.

const DEAD_ZONE = 0.12; // of a control's way
const HELD = 0.5; // of the way of a button or trigger
export const MOTIONS = ["x", "y", "z", "roll"];
/** With `hold` nothing moves unless it is held: a dead-man. */
const HELD_CONTROLS = ["hold", "clutch", "camera", "enable", "stop", "record"];
const CONTROLS = [...MOTIONS, "close", "open", ...HELD_CONTROLS];

// A control has sources: the axis or button, its value at rest, and that at the end of the way; or
// the axis of a hat and the direction in which it is pushed.
const axis = (index, end = 1) => ({ axis: index, rest: 0, end });
const button = (index) => ({ button: index, rest: 0, end: 1 });
export const STANDARD = {
  x: [axis(0)],
  y: [axis(1)],
  z: [axis(3, -1)], // pushed forward: away from the viewer
  roll: [axis(2)],
  close: [button(7)],
  open: [button(6)],
  clutch: [button(4)],
  camera: [button(5)],
  enable: [button(9)],
  stop: [button(1), button(8)],
  record: [button(2)],
};

const key = (pad) => `${pad.index} ${pad.id}`;

export class Pads {
  /**
   * @param mappingOf gives the sources of a pad's controls, or null: it does nothing
   * @param lost called when the pad in use is gone
   */
  constructor(mappingOf, lost) {
    this.mappingOf = mappingOf;
    this.lost = lost;
    this.seen = new Map(); // pad -> its controls that have been at rest, and those held
    this.mine = null; // the pad that was touched first, until it is gone
    this.inUse = null;
    this.lesson = null; // while a person maps a pad, none moves anything
  }

  /** The pad in use, or an idle one: its wish, what is held and what was pressed; null: none. */
  read() {
    const pads = [...navigator.getGamepads()].filter((pad) => pad?.connected);
    const here = new Set(pads.map(key));
    for (const gone of [...this.seen.keys()].filter((each) => !here.has(each))) this.seen.delete(gone);
    if (this.mine !== null && !here.has(this.mine)) {
      this.mine = null;
      this.lost();
    }
    const readings = pads.map((pad) => this.reading(pad));
    const mine = readings.find(({ pad }) => key(pad) === this.mine);
    const chosen = mine ?? readings.find(({ used }) => used) ?? readings[0] ?? null;
    if (chosen?.used) this.mine = key(chosen.pad);
    this.inUse = chosen?.pad ?? null;
    return chosen;
  }

  reading(pad) {
    const mapping = this.lesson === null ? this.mappingOf(pad) : null;
    const before = this.seen.get(key(pad)) ?? { rested: new Set(), held: new Set() };
    const { rested } = before;
    const way = {};
    for (const name of CONTROLS) {
      const shares = (mapping?.[name] ?? []).map((source) => share(pad, source));
      const far = shares.reduce((a, b) => (Math.abs(b) > Math.abs(a) ? b : a), 0);
      if (Math.abs(far) < DEAD_ZONE) rested.add(name);
      // Held or deflected when the pad came, or never moved so that its rest is unknown: not meant.
      way[name] = rested.has(name) || name === "stop" ? far : 0;
    }
    const held = new Set(HELD_CONTROLS.filter((name) => way[name] > HELD));
    const may = !mapping?.hold || held.has("hold");
    const wish = { x: 0, y: 0, z: 0, roll: 0, grip: 0 };
    if (may) {
      for (const name of MOTIONS) wish[name] = deadZone(way[name]);
      wish.grip = pulled(way.open) - pulled(way.close);
    }
    this.seen.set(key(pad), { rested, held });
    const pressed = [...held].filter((name) => !before.held.has(name));
    const used = held.size > 0 || Object.values(wish).some(Boolean);
    return { pad, wish, held, pressed, used, mapped: mapping !== null };
  }
}

/** How far a source is from its rest to its end, -1 … 1; what is no number is at rest. */
function share(pad, { axis, button, hat, rest, end }) {
  const value = axis === undefined ? pad.buttons[button]?.value : pad.axes[axis];
  if (hat !== undefined) return likeness({ axis, hat: direction(value) }, { axis, hat });
  const part = (value - rest) / (end - rest);
  return Number.isFinite(part) ? Math.max(-1, Math.min(1, part)) : 0;
}

/**
 * A hat of one number says -1 … 1 clockwise from up, in eighths of a turn, and anything else at
 * rest: 0 … 7, or null.
 */
export function direction(value) {
  const eighths = ((value + 1) * 7) / 2;
  const whole = Math.round(eighths);
  return whole >= 0 && whole <= 7 && Math.abs(eighths - whole) < 0.05 ? whole : null;
}

/** Of two sources: 1 for the same way of the same control, -1 for the other way, 0 for others. */
export function likeness(a, b) {
  if (a.axis !== b.axis || a.button !== b.button) return 0;
  if (a.hat === undefined || b.hat === undefined) return Math.sign((a.end - a.rest) * (b.end - b.rest));
  return a.hat === null ? 0 : Math.cos(((a.hat - b.hat) * Math.PI) / 4);
}

/** A stick's deflection beyond a dead zone, squared for fine small motions. */
function deadZone(way) {
  const beyond = Math.max(0, Math.abs(way) - DEAD_ZONE) / (1 - DEAD_ZONE);
  return Math.sign(way) * beyond ** 2;
}

const pulled = (way) => (way > DEAD_ZONE ? way : 0);
