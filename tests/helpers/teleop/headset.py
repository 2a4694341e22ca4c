"""A headset that is not there: `navigator.xr` for `Chromium.open`, held by a test."""

FAKE_XR = """
(() => {
  const mul = (a, b) => { // column-major 4 x 4
    const c = new Float32Array(16);
    for (let i = 0; i < 4; i += 1) for (let j = 0; j < 4; j += 1) for (let k = 0; k < 4; k += 1)
      c[4 * i + j] += a[4 * k + j] * b[4 * i + k];
    return c;
  };
  const turned = ([x, y, z, w]) => new Float32Array([
    1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0,
    2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0,
    2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0, 0, 0, 0, 1]);
  const shifted = ([x, y, z]) => new Float32Array([1,0,0,0, 0,1,0,0, 0,0,1,0, x,y,z,1]);
  const transform = (p, q) => ({
    position: { x: p[0], y: p[1], z: p[2], w: 1 },
    orientation: { x: q[0], y: q[1], z: q[2], w: q[3] },
    matrix: mul(shifted(p), turned(q)),
    inverse: { matrix: mul(turned([-q[0], -q[1], -q[2], q[3]]), shifted(p.map((v) => -v))) },
  });
  const button = () => ({ pressed: false, value: 0 });
  const controller = (handedness, p) => ({
    handedness, p, q: [0, 0, 0, 1], seen: true, emulated: false, pulses: 0, pulsed: [],
    buttons: Array.from({ length: 6 }, button),
  });
  const fake = {
    head: { p: [0, 1.6, 0], q: [0, 0, 0, 1] },
    left: controller("left", [-0.2, 1.2, -0.3]),
    right: controller("right", [0.2, 1.2, -0.3]),
    there: ["left", "right"], pixels: null, row: null, wantPixels: false,
    session: null, space: null,
  };
  fake.hold = (hand, index, value) => {
    fake[hand].buttons[index] = { pressed: value > 0.5, value };
    return 0;
  };
  fake.move = (hand, by) => { fake[hand].p = fake[hand].p.map((v, i) => v + by[i]); return 0; };
  fake.show = (state) => {
    fake.session.visibilityState = state;
    fake.session.dispatchEvent(new Event("visibilitychange"));
    return 0;
  };
  globalThis.fakeXR = fake;
  class Session extends EventTarget {
    constructor() {
      super();
      this.visibilityState = "visible";
      this.waiting = [];
      this.layer = null;
      const loop = () => {
        const now = this.waiting;
        this.waiting = [];
        if (this.visibilityState !== "visible") this.waiting = now;
        else for (const call of now) call(performance.now(), frame);
        this.look();
        setTimeout(loop, 14);
      };
      setTimeout(loop, 14);
    }
    get inputSources() {
      return fake.there.map((hand) => ({
        handedness: hand, targetRaySpace: { hand, kind: "ray" }, gripSpace: { hand, kind: "grip" },
        gamepad: { buttons: fake[hand].buttons,
                   hapticActuators: [{ pulse: async (...pulse) => {
                     fake[hand].pulses += 1;
                     fake[hand].pulsed.push(pulse);
                   } }] },
      }));
    }
    updateRenderState({ baseLayer }) { this.layer = baseLayer; }
    async requestReferenceSpace() { fake.space = new EventTarget(); return fake.space; }
    requestAnimationFrame(call) { this.waiting.push(call); return 1; }
    look() {
      if (!fake.wantPixels || !this.layer) return;
      const { gl } = this.layer, { width, height } = gl.canvas;
      fake.pixels = [0.25, 0.75].map((x) => {
        const found = new Uint8Array(4);
        gl.readPixels(Math.round(x * width), height / 2, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, found);
        return [...found];
      });
      const row = new Uint8Array(4 * width);
      gl.readPixels(0, height / 2, width, 1, gl.RGBA, gl.UNSIGNED_BYTE, row);
      fake.row = Array.from({ length: width }, (_, i) => row[4 * i]);
    }
    end() { this.dispatchEvent(new Event("end")); }
  }
  const frame = {
    getViewerPose: () => ({
      transform: transform(fake.head.p, fake.head.q), emulatedPosition: false,
      views: ["left", "right"].map((eye, i) => ({
        eye, projectionMatrix: new Float32Array([1,0,0,0, 0,1,0,0, 0,0,-1,-1, 0,0,-0.2,0]),
        transform: transform(
          fake.head.p.map((v, k) => v + (k ? 0 : 0.03 * (2 * i - 1))), fake.head.q),
      })),
    }),
    getPose: ({ hand, kind }) => {
      const { seen, emulated, p, q } = fake[hand];
      return seen ? { transform: transform(p, q), emulatedPosition: emulated } : null;
    },
  };
  globalThis.XRWebGLLayer = class {
    constructor(session, gl) { this.gl = gl; this.framebuffer = null; }
    getViewport({ eye }) {
      const { width, height } = this.gl.canvas;
      return { x: eye === "right" ? width / 2 : 0, y: 0, width: width / 2, height };
    }
  };
  const xr = {
    isSessionSupported: async () => true,
    requestSession: async () => { fake.session = new Session(); return fake.session; },
  };
  Object.defineProperty(navigator, "xr", { value: xr, configurable: true });
})();
"""
"""`fakeXR.hold(hand, button, value)`, `.move(hand, [x, y, z])`, `.show(visibilityState)`; buttons
of the mapping "xr-standard": 0 trigger, 1 squeeze, 4 A or X, 5 B or Y."""

NO_XR = "Object.defineProperty(navigator, 'xr', { value: undefined, configurable: true });"
"""A browser without WebXR."""

NO_WEBGL = (
    FAKE_XR
    + """
{ const real = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    return kind === "webgl2" ? null : real.call(this, kind, ...more); }; }
"""
)
"""A headset, and a browser without WebGL 2."""
