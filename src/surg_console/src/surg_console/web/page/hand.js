// Motion of the hand from mouse, fingers, keyboard and gamepad, in the view frame: x right, y down, z
// away from the viewer. Mouse and fingers are a position leader; keys and gamepad are rate leaders.

const METRES_PER_PIXEL = 0.0005; // of the hand; the console's scale comes on top
const METRES_PER_NOTCH = 0.004;
const RADIANS_PER_PIXEL = 0.008;
const SMOOTHING_S = 0.05; // of the mouse's steps
const ROLL_RATE = 1.2; // [rad/s]
const TILT_RATE = 0.8; // [rad/s] of a wrist
const GRIP_RATE = 1.5; // [1/s] fully open to closed in two thirds of a second
const SLOW = 0.25;

// key -> axis and direction
const MOTION_KEYS = {
  KeyA: ["x", -1], ArrowLeft: ["x", -1],
  KeyD: ["x", 1], ArrowRight: ["x", 1],
  KeyW: ["y", -1], ArrowUp: ["y", -1],
  KeyS: ["y", 1], ArrowDown: ["y", 1],
  KeyR: ["z", 1], PageUp: ["z", 1],
  KeyF: ["z", -1], PageDown: ["z", -1],
  KeyQ: ["roll", -1], KeyE: ["roll", 1], Home: ["roll", -1], End: ["roll", 1],
  Digit7: ["tilt_y", -1], Digit8: ["tilt_x", 1], Digit9: ["tilt_x", -1], Digit0: ["tilt_y", 1],
  KeyK: ["grip", -1], KeyL: ["grip", 1], Delete: ["grip", -1], Insert: ["grip", 1],
};
const HELD_KEYS = { Space: "clutch", KeyC: "camera" };
const PRESSED_KEYS = {
  Enter: "enable", Escape: "stop", KeyV: "record", KeyP: "policy", KeyM: "hand", KeyT: "take", KeyH: "guide_home",
  KeyB: "eyes", KeyZ: "size", KeyJ: "side", KeyN: "marks", KeyI: "plan", KeyO: "scene", KeyY: "feel", Slash: "help",
  KeyG: "new_episode", Digit1: "success", Digit2: "failure", Digit3: "discard",
  Minus: "less_scale", Equal: "more_scale", BracketLeft: "slower", BracketRight: "faster",
};

export class Hand {
  /**
   * @param view the element over which the mouse moves the tip
   * @param press called with a word of PRESSED_KEYS
   * @param lost called with "pointer" when mouse or keyboard are gone while a hand was on them
   * @param pads reads the gamepads; null: there are none
   */
  constructor(view, press, lost, pads = null) {
    this.view = view;
    this.press = press;
    this.lost = lost;
    this.hand = "position";
    this.speed = 0.02; // [m/s] of the tip at full deflection
    this.grip = null;
    this.latched = { clutch: false, camera: false };
    this.mayChange = () => true; // whether the kind of hand may change now
    this.goal = { x: 0, y: 0, z: 0, roll: 0 };
    this.now = { ...this.goal };
    this.keys = new Set();
    this.pads = pads;
    this.padHeld = new Set();
    this.padName = "";
    this.pointer = null; // that drags
    this.fingers = new Map(); // on the view: pointer -> place
    this.several = false; // since the first of them came down there were two or more
    this.listen();
  }

  listen() {
    addEventListener("keydown", (event) => this.keyDown(event));
    addEventListener("keyup", (event) => this.keys.delete(event.code));
    addEventListener("blur", () => this.loseFocus());
    this.view.addEventListener("pointerdown", (event) => this.pointerDown(event));
    this.view.addEventListener("pointermove", (event) => this.pointerMove(event));
    this.view.addEventListener("pointerup", (event) => this.fingerUp(event));
    this.view.addEventListener("pointercancel", (event) => this.fingerLost(event));
    this.view.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.view.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  keyDown(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const code = event.key === "?" ? "Slash" : event.code; // wherever the keyboard has it
    if (code.startsWith("Shift")) this.keys.add(code);
    const ours = code in MOTION_KEYS || code in HELD_KEYS || code in PRESSED_KEYS;
    const slider = event.target instanceof HTMLInputElement && code.startsWith("Arrow");
    const followed = event.target instanceof HTMLAnchorElement && code === "Enter";
    if (!ours || slider || followed) return;
    event.preventDefault();
    if (code in PRESSED_KEYS) {
      if (!event.repeat) this.press(PRESSED_KEYS[code]);
      return;
    }
    if (code in MOTION_KEYS && MOTION_KEYS[code][0] !== "grip" && !this.use("rate")) return;
    this.keys.add(code);
  }

  /** Change the kind of hand; returns whether it is allowed now. */
  use(hand) {
    if (this.hand === hand) return true;
    if (!this.mayChange(hand)) return false;
    this.hand = hand;
    return true;
  }

  pointerDown(event) {
    if (event.target.closest("button")) return;
    if (!this.use("position")) return;
    if (event.pointerType === "touch") {
      this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
      this.several ||= this.fingers.size > 1;
      return;
    }
    this.pointer = event.pointerId;
    this.view.setPointerCapture(this.pointer);
  }

  /** The release of a key elsewhere is never reported; a clutch must not open unnoticed. */
  loseFocus() {
    const drags = this.pointer !== null && this.view.hasPointerCapture(this.pointer);
    const acts = [...this.keys].some((code) => code in MOTION_KEYS || code in HELD_KEYS);
    if (drags || acts || this.fingers.size) this.lost("pointer");
    this.fingers.clear();
    this.several = false;
    if (drags) this.view.releasePointerCapture(this.pointer);
    this.keys.clear();
  }

  /** One finger moves in the picture. Two move along the view, both up or down, and turn the roll. */
  fingerMove(event) {
    const before = this.fingers.get(event.pointerId);
    const after = [event.clientX, event.clientY];
    this.fingers.set(event.pointerId, after);
    if (this.hand !== "position") return;
    if (this.fingers.size === 2) {
      const [other] = [...this.fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const angle = (place) => Math.atan2(place[1] - other[1], place[0] - other[0]);
      const turn = angle(after) - angle(before);
      this.goal.roll += Math.atan2(Math.sin(turn), Math.cos(turn));
      this.goal.z -= ((after[1] - before[1]) / 2) * METRES_PER_PIXEL;
    } else if (this.fingers.size === 1 && !this.several) {
      this.goal.x += (after[0] - before[0]) * METRES_PER_PIXEL;
      this.goal.y += (after[1] - before[1]) * METRES_PER_PIXEL;
    }
  }

  /** What is left of several fingers moves nothing: they are never lifted at once. */
  fingerUp(event) {
    this.fingers.delete(event.pointerId);
    if (!this.fingers.size) this.several = false;
  }

  /** The system has taken the touch for itself; it is not known what the finger does. */
  fingerLost(event) {
    if (!this.fingers.has(event.pointerId)) return;
    this.fingerUp(event);
    this.lost("pointer");
  }

  pointerMove(event) {
    if (this.fingers.has(event.pointerId)) {
      this.fingerMove(event);
      return;
    }
    if (!this.view.hasPointerCapture(event.pointerId) || this.hand !== "position") return;
    const along = event.shiftKey || (event.buttons & 2) !== 0;
    if (along) {
      this.goal.z -= event.movementY * METRES_PER_PIXEL;
      this.goal.roll += event.movementX * RADIANS_PER_PIXEL;
    } else {
      this.goal.x += event.movementX * METRES_PER_PIXEL;
      this.goal.y += event.movementY * METRES_PER_PIXEL;
    }
  }

  wheel(event) {
    event.preventDefault();
    if (this.hand !== "position") return;
    const notches = Math.max(-3, Math.min(3, -event.deltaY / 100));
    this.goal.z += notches * METRES_PER_NOTCH;
  }

  /** The wish of the gamepad, after pressing what went down. */
  readGamepad() {
    const rest = { x: 0, y: 0, z: 0, roll: 0, tilt_x: 0, tilt_y: 0, grip: 0 };
    const read = this.pads?.read() ?? null;
    this.padHeld = read?.held ?? new Set();
    this.padName = read ? read.pad.id.replace(/\s*\(.*$/, "") || "Gamepad" : "";
    if (!read) return rest;
    if (!read.mapped) this.padName += " moves nothing until you press Map gamepad.";
    for (const word of ["enable", "stop", "record"]) if (read.pressed.includes(word)) this.press(word);
    const { grip, ...motion } = read.wish;
    if (Object.values(motion).some(Boolean) && !this.use("rate")) return { ...rest, grip };
    return { ...rest, ...read.wish };
  }

  held(name) {
    const key = Object.keys(HELD_KEYS).find((code) => HELD_KEYS[code] === name);
    return this.latched[name] || this.keys.has(key) || this.padHeld.has(name);
  }

  /** The sample for the console, `seconds` after the last one. */
  sample(seconds) {
    const wish = this.readGamepad();
    for (const code of this.keys) {
      const [name, sign] = MOTION_KEYS[code] ?? [];
      if (name) wish[name] += sign;
    }
    const slow = this.keys.has("ShiftLeft") || this.keys.has("ShiftRight") ? SLOW : 1;
    if (wish.grip && this.grip === null) this.grip = 1; // the hand takes over the jaw
    if (this.grip !== null) this.grip = clamp(this.grip + wish.grip * GRIP_RATE * seconds, 0, 1);
    const part = 1 - Math.exp(-seconds / SMOOTHING_S);
    for (const name in this.now) this.now[name] += (this.goal[name] - this.now[name]) * part;
    const rate = this.hand === "rate";
    const v = rate ? limited([wish.x, wish.y, wish.z], this.speed * slow) : [0, 0, 0];
    return {
      hand: this.hand,
      p: [this.now.x, this.now.y, this.now.z],
      q: [0, 0, Math.sin(this.now.roll / 2), Math.cos(this.now.roll / 2)],
      v,
      roll_rate: rate ? clamp(wish.roll, -1, 1) * ROLL_RATE * slow : 0,
      tilt_x: rate ? clamp(wish.tilt_x, -1, 1) * TILT_RATE * slow : 0,
      tilt_y: rate ? clamp(wish.tilt_y, -1, 1) * TILT_RATE * slow : 0,
      grip: this.grip,
      clutch: this.held("clutch"),
      camera: this.held("camera"),
    };
  }

  /** Forget held keys and motion that was not sent yet. */
  rest() {
    this.keys.clear();
    this.goal = { ...this.now };
    this.several = this.fingers.size > 0; // they must be lifted first
    this.latched = { clutch: false, camera: false };
  }
}

function clamp(value, low, high) {
  return Math.max(low, Math.min(high, value));
}

/** A velocity of at most `speed`. */
function limited(wish, speed) {
  const length = Math.hypot(...wish);
  return wish.map((part) => (part * speed) / Math.max(1, length));
}
