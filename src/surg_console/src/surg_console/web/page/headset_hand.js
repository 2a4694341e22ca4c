// What the controllers of a headset say to the console. Everything is raw: whether a squeeze counts
// is decided by the console (session/dead_man.py).

const TRIGGER = 0, SQUEEZE = 1, LOWER = 4, UPPER = 5; // buttons of the mapping "xr-standard"
const TOUCHED = 0.05;
const LOOK_AT_M = 0.3; // the head moves the endoscope by a point so far before the eyes
const LONG_PRESS_S = 1;

// --- quaternions [x, y, z, w] ---

export function multiply([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

export const inverse = ([x, y, z, w]) => [-x, -y, -z, w];

export function rotate(q, [x, y, z]) {
  return multiply(multiply(q, [x, y, z, 0]), inverse(q)).slice(0, 3);
}

const list = ({ x, y, z, w }) => (w === undefined ? [x, y, z] : [x, y, z, w]);

function unit(q) {
  const length = Math.hypot(...q);
  return q.map((part) => part / length);
}

/**
 * A pose of the room in the view frame of the screen: x right, y down, z into it. The handle's third
 * axis points out of the hand, where the controller's points backwards.
 */
export function inView(p, q, screen) {
  const back = inverse(screen.q);
  const [x, y, z] = rotate(back, p.map((part, i) => part - screen.p[i]));
  const [qx, qy, qz, qw] = unit(multiply(back, q));
  return { p: [x, -y, -z], q: [qx, -qy, -qz, qw] };
}

export class HeadsetHand {
  /** @param press called with "enable", "stop", "record"; `recentre` with nothing */
  constructor(press, recentre) {
    this.press = press;
    this.recentre = recentre;
    this.byHead = false; // the head moves the endoscope, instead of the left hand
    this.grip = null;
    this.down = new Set();
    this.real = new Set(); // hands whose place the headset has really seen
    this.used = []; // hands that were squeezed in the last frame
    this.longSince = null;
    this.at = { p: [0, 0, 0], q: [0, 0, 0, 1] };
    this.felt = false; // whether the motor has played the force at the tip
  }

  /** Controllers by hand. */
  sources(session) {
    return Object.fromEntries([...session.inputSources]
      .filter((source) => source.gamepad && ["left", "right"].includes(source.handedness))
      .map((source) => [source.handedness, source]));
  }

  /** Where a controller is, or null: it is not tracked. */
  pose(frame, source, space) {
    const ray = frame.getPose(source.targetRaySpace, space);
    const held = source.gripSpace ? frame.getPose(source.gripSpace, space) : ray;
    if (!ray || !held) return null;
    const { handedness } = source;
    // Some browsers call every place emulated: only one that was real before counts as lost.
    if (!held.emulatedPosition) this.real.add(handedness);
    else if (this.real.has(handedness)) return null;
    return { p: list(held.transform.position), q: list(ray.transform.orientation) };
  }

  headPose(frame, space) {
    const viewer = frame.getViewerPose(space);
    if (!viewer || viewer.emulatedPosition) return null;
    const q = list(viewer.transform.orientation);
    const before = rotate(q, [0, 0, -LOOK_AT_M]);
    return { p: list(viewer.transform.position).map((part, i) => part + before[i]), q };
  }

  /** The sample of one frame; `seconds`: the page's clock. */
  sample(frame, space, session, screen, seconds) {
    const { left, right } = this.sources(session);
    this.buttons(left, right, seconds);
    const holds = (source) => source?.gamepad.buttons[SQUEEZE]?.pressed ?? false;
    const camera = holds(left);
    const squeezed = [["left", left], ["right", right]].filter(([, s]) => holds(s)).map(([hand]) => hand);
    const gone = this.used.some((hand) => !(hand === "left" ? left : right));
    this.used = squeezed;
    const hand = camera ? left : right;
    let pose = hand ? this.pose(frame, hand, space) : null;
    if (pose && camera && this.byHead) pose = this.headPose(frame, space);
    if (pose) this.at = inView(pose.p, pose.q, screen);
    const pull = right?.gamepad.buttons[TRIGGER]?.value ?? 0;
    if (right && (this.grip !== null || pull > TOUCHED)) this.grip = 1 - Math.min(1, pull);
    return {
      hand: "position",
      ...this.at,
      grip: this.grip,
      camera,
      squeeze: squeezed.length > 0,
      tracked: pose !== null && !gone,
    };
  }

  buttons(left, right, seconds) {
    const down = new Set();
    const note = (name, source, i) => { if (source?.gamepad.buttons[i]?.pressed) down.add(name); };
    note("enable", right, LOWER);
    note("stop", right, UPPER);
    note("record", left, LOWER);
    note("recentre", left, UPPER);
    for (const name of ["stop", "enable", "record"]) {
      if (down.has(name) && !this.down.has(name)) this.press(name);
    }
    if (!down.has("recentre")) this.longSince = null;
    else if (!this.down.has("recentre")) this.longSince = seconds;
    if (this.longSince !== null && seconds - this.longSince >= LONG_PRESS_S) {
      this.longSince = null;
      this.recentre();
    }
    this.down = down;
  }

  /** A pulse on the hand that moves something. */
  pulse(session) {
    const { left, right } = this.sources(session);
    const source = this.used.includes("left") ? left : right;
    source?.gamepad.hapticActuators?.[0]?.pulse?.(0.6, 60);
  }

  /** The motor of the right controller, as a gamepad has one; null: it has none. */
  motor(session) {
    const actuator = this.sources(session).right?.gamepad.hapticActuators?.[0];
    if (!actuator?.pulse) return null;
    return {
      playEffect: async (_kind, { duration, strongMagnitude }) => {
        this.felt = true;
        await actuator.pulse(strongMagnitude, duration);
      },
      reset: () => {
        if (this.felt) actuator.pulse(0, 1); // else it would end a pulse at a wall
        this.felt = false;
      },
    };
  }
}
