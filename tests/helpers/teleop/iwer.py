"""Meta's WebXR emulator `iwer` (npm, MIT) behind the same words as `headset.FAKE_XR`.

Fetched by npm on request, checked against its hash, kept beside the checkout and never in git.
"""

from __future__ import annotations

import base64
import hashlib
import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest

from surg_cli.host import paths

VERSION = "2.5.0"
SHA512 = "grq7iMyWo4s2DYnATKLPPoAByhcNuwLjMHHOILrFU9q8EGHIEzHyUuq1mz+9Xqy6+xrYPn3Ho8Z9eymZCE+D6w=="
"""As npm's registry states it."""
FILE = "package/build/iwer.min.js"

_FACADE = """
{
  const device = new IWER.XRDevice(IWER.metaQuest3);
  device.installRuntime({ forceInstall: true });
  device.stereoEnabled = true;
  device.primaryInputMode = "controller";
  device.position.set(0, 1.6, 0);
  for (const [hand, x] of [["left", -0.2], ["right", 0.2]]) {
    device.controllers[hand].position.set(x, 1.2, -0.3);
    device.controllers[hand].quaternion.set(0, 0, 0, 1);
  }
  const NAMES = { left: ["trigger", "squeeze", "", "", "x-button", "y-button"],
                  right: ["trigger", "squeeze", "", "", "a-button", "b-button"] };
  const fake = { head: {}, pixels: null, wantPixels: false, pulses: 0, device };
  fake.hold = (hand, i, value) => {
    device.controllers[hand].updateButtonValue(NAMES[hand][i], value);
    return 0;
  };
  fake.move = (hand, by) => {
    const { position } = device.controllers[hand];
    ["x", "y", "z"].forEach((axis, i) => { position[axis] += by[i]; });
    return 0;
  };
  fake.show = (state) => { device.updateVisibilityState(state); return 0; };
  globalThis.fakeXR = fake;
  const Layer = globalThis.XRWebGLLayer;
  globalThis.XRWebGLLayer = class extends Layer {
    constructor(session, gl, ...more) { super(session, gl, ...more); fake.gl = gl; }
  };
  const ask = XRSession.prototype.requestAnimationFrame;
  XRSession.prototype.requestAnimationFrame = function (call) {
    return ask.call(this, (time, frame) => {
      call(time, frame);
      if (!fake.wantPixels || !fake.gl) return;
      const { gl } = fake, { width, height } = gl.canvas;
      fake.pixels = [0.25, 0.75].map((x) => {
        const found = new Uint8Array(4);
        gl.readPixels(Math.round(x * width), height / 2, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, found);
        return [...found];
      });
    });
  };
}
"""


def script() -> str:
    """JavaScript for `Chromium.open`: the emulator, installed; skips the test without npm."""
    archive = paths.ROOT / ".venv-oracle-iwer" / f"iwer-{VERSION}.tgz"
    if not archive.exists():
        if shutil.which("npm") is None:
            pytest.skip("missing: npm (Debian packages nodejs, npm)")
        archive.parent.mkdir(exist_ok=True)
        words = ["npm", "pack", f"iwer@{VERSION}", "--pack-destination", str(archive.parent)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"missing: npm's package iwer: {done.stderr.strip()[-200:]}")
    found = base64.b64encode(hashlib.sha512(archive.read_bytes()).digest()).decode()
    assert found == SHA512, f"{archive}: not the package that is pinned"
    return _member(archive) + _FACADE


def _member(archive: Path) -> str:
    with tarfile.open(archive) as package:
        file = package.extractfile(FILE)
        assert file is not None
        return file.read().decode()
