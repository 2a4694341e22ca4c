"""Gamepads as browsers show them, and a page's script that rests, maps and moves one of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

AXIS, BUTTON, HAT = "axis", "button", "hat"
RIGHT, DOWN, LEFT, UP = -3 / 7, 1 / 7, 5 / 7, -1.0
"""What the one axis of a hat says."""
NOWHERE = 9 / 7
"""What it says untouched."""


@dataclass(frozen=True)
class Layout:
    """A pad without the standard mapping."""

    rest: tuple[float, ...]  # of the axes
    buttons: int
    controls: dict[str, tuple[str, int, float]]  # name -> kind, index, value at its end
    first: dict[int, float] = field(default_factory=dict)  # what axes say until they are touched
    nan: int = -1  # an axis that is no number

    def document(self) -> dict[str, Any]:
        """For `TRIAL`."""
        return {
            "rest": self.rest,
            "buttons": self.buttons,
            "controls": self.controls,
            "first": self.first,
            "nan": self.nan,
        }


def _sticks(x: int, y: int, z: int, roll: int) -> dict[str, tuple[str, int, float]]:
    return {"x": (AXIS, x, 1), "y": (AXIS, y, 1), "z": (AXIS, z, -1), "roll": (AXIS, roll, 1)}


def _hat(hat: int, z: int, roll: int) -> dict[str, tuple[str, int, float]]:
    return _sticks(0, 0, z, roll) | {"x": (HAT, hat, RIGHT), "y": (HAT, hat, DOWN)}


def _buttons(*names: str, first: int = 0) -> dict[str, tuple[str, int, float]]:
    return {name: (BUTTON, first + i, 1) for i, name in enumerate(names)}


ALL = ("hold", "clutch", "camera", "enable", "stop", "record")
JAW = ("close", "open")
LAYOUTS = {
    "four axes": Layout((0, 0, 0, 0), 17, _sticks(0, 1, 3, 2) | _buttons(*JAW, *ALL)),
    "LX LY LT RX RY RT": Layout(
        (0, 0, -1, 0, 0, -1, 0, 0),
        11,
        _sticks(0, 1, 4, 3) | {"open": (AXIS, 2, 1), "close": (AXIS, 5, 1)} | _buttons(*ALL),
    ),
    "triggers that say 0 at first": Layout(
        (0, 0, -1, 0, 0, -1),
        11,
        _sticks(0, 1, 4, 3) | {"open": (AXIS, 2, 1), "close": (AXIS, 5, 1)} | _buttons(*ALL),
        first={2: 0.0, 5: 0.0},
    ),
    "sticks swapped": Layout((0, 0, 0, 0), 12, _sticks(2, 3, 1, 0) | _buttons(*JAW, *ALL)),
    "LX LY RX LT RT RY": Layout(
        (0, 0, 0, -1, -1, 0),
        13,
        _sticks(0, 1, 5, 2) | {"open": (AXIS, 3, 1), "close": (AXIS, 4, 1)} | _buttons(*ALL),
    ),
    "one axis for both triggers": Layout(
        (0, 0, 0, 0, 0),
        10,
        _sticks(0, 1, 4, 3) | {"open": (AXIS, 2, 1), "close": (AXIS, 2, -1)} | _buttons(*ALL),
    ),
    "flight stick, throttle forward": Layout(
        (0, 0, -1, 0), 12, {**_sticks(0, 1, 2, 3), "z": (AXIS, 2, 1)} | _buttons(*JAW, *ALL)
    ),
    "flight stick, throttle anywhere": Layout(
        (0.08, -0.05, 0.3, 0.02), 12, _sticks(0, 1, 2, 3) | _buttons("stop", "enable")
    ),
    "wheel": Layout((0, 1, 1, 1), 24, {"x": (AXIS, 0, 1), "z": (AXIS, 2, -1)} | _buttons(*ALL)),
    "hat of two axes": Layout((0, 0, 0, 0, 0, 0), 12, _sticks(4, 5, 1, 0) | _buttons(*JAW, *ALL)),
    "hat of one number": Layout((0, 0, 0, 0, NOWHERE), 14, _hat(4, 0, 1) | _buttons(*JAW, *ALL)),
    "hat of one number that says 0 at first": Layout(
        (0, 0, 0, 0, NOWHERE), 14, _hat(4, 0, 1) | _buttons(*JAW, *ALL), first={4: 0.0}
    ),
    "hat of one number that rests at 0": Layout(
        (0, 0, 0, 0, 0), 14, _hat(4, 0, 1) | _buttons(*JAW, *ALL)
    ),
    "hat of one number for the jaw and two buttons": Layout(
        (0, 0, 0, 0, NOWHERE),
        14,
        _sticks(0, 1, 3, 2)
        | {"close": (HAT, 4, UP), "open": (HAT, 4, DOWN)}
        | {"camera": (HAT, 4, LEFT), "clutch": (HAT, 4, RIGHT)}
        | _buttons("hold", "enable", "stop", "record"),
    ),
    "trackball": Layout((0.04, -0.03), 3, _buttons("clutch", "enable", "stop")),
    "an axis that is no number": Layout((0, 0, 0, 0, 0), 8, _sticks(0, 1, 3, 2), nan=4),
}

TRIAL = """
(async (layout) => {
  const { Lesson, STEPS, readMapping } = await import("/page/pads/lesson.js");
  const { Pads } = await import("/page/pads/pads.js");
  const fresh = () => ({
    id: "trial", index: 3, connected: true, mapping: "",
    axes: layout.rest.map((v, i) => (i === layout.nan ? NaN : layout.first[i] ?? v)),
    buttons: Array.from({ length: layout.buttons }, () => ({ pressed: false, value: 0 })),
  });
  let pad = fresh(), mapping = null, now = 0, lost = 0;
  const real = navigator.getGamepads;
  navigator.getGamepads = () => [pad];
  const pads = new Pads(() => mapping, () => { lost += 1; });
  const put = ([kind, i, end], part) => {
    if (kind === "hat") pad.axes[i] = part > 0.5 ? end : layout.rest[i];
    else if (kind === "axis") pad.axes[i] = layout.rest[i] + part * (end - layout.rest[i]);
    else pad.buttons[i] = { pressed: part > 0.5, value: part };
  };
  const said = () => {
    const { wish, held, pressed } = pads.read();
    return { ...wish, held: [...held], pressed };
  };
  const nothing = () => Object.values(said()).flat().every((each) => each === 0);
  const all = Object.entries(layout.controls);
  const out = { still: true, untouched: true, stages: {} };
  for (let i = 0; i < 30; i++) out.still &&= nothing();
  for (const [, control] of all) { // whatever is moved: nobody has mapped it
    for (const part of [1, 0]) { put(control, part); out.untouched &&= nothing(); }
  }
  pad = fresh();
  const lesson = new Lesson("trial");
  const wait = (seconds) => {
    for (const end = now + seconds; now < end;) lesson.feed(pad, (now += 0.02));
  };
  for (const [name] of STEPS) {
    const control = layout.controls[name];
    if (!control) { lesson.skip(); continue; }
    wait(0.5);
    const step = lesson.step;
    for (let part = 0; part <= 1.001; part += 0.1) { put(control, part); wait(0.02); }
    wait(1);
    if (lesson.step !== step) out.stages[name] = "learnt while it was held";
    put(control, 0);
    wait(1);
    if (lesson.step !== step + 1) out.stages[name] = lesson.sentence;
  }
  mapping = readMapping(JSON.stringify(lesson.mapping));
  pad = { ...fresh(), index: 4 };
  for (let i = 0; i < 5; i++) out.still &&= nothing();
  for (const [, control] of all) put(control, 0);
  out.still &&= nothing();
  if (layout.controls.hold && layout.controls.x) {
    put(layout.controls.x, 1);
    out.unheld = said().x;
    put(layout.controls.x, 0);
    put(layout.controls.hold, 1);
  }
  said();
  out.did = {};
  for (const [name, control] of all.filter(([each]) => each !== "hold")) {
    put(control, 1);
    out.did[name] = said();
    put(control, 0);
    said();
  }
  if (layout.controls.x) put(layout.controls.x, 1);
  else put(layout.controls.clutch, 1);
  said();
  const kept = pad;
  pad = null;
  pads.read();
  out.lost = lost;
  pad = kept; // plugged in again, still deflected
  out.back = said();
  navigator.getGamepads = real;
  return out;
})
"""
"""Called with `Layout.document()`: rests, maps and moves the pad through the page's own files."""
