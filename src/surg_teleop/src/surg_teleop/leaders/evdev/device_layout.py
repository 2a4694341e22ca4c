"""A layout file: which axes and buttons a device has, and what each of them means.

One YAML file per kind of device; ``docs/guide/leaders.md`` explains the keys. Bundled ones lie in
``layouts/`` and go by their name.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import yaml
from evdev import ecodes

from surg_core.contract import VIRTUAL_JOINTS
from surg_core.hand.leader_sample import BUTTONS
from surg_teleop.leaders.evdev.device_state import Description
from surg_teleop.leaders.leader import LeaderError

FORMAT = "surg_input/1"
FOLDER = Path(__file__).with_name("layouts")
ELSEWHERE = "elsewhere"
"""Value of ``dead_man``: a pedal or the console reports the operator's presence."""

VIEW = ("x", "y", "z", "roll", "tilt_x", "tilt_y")
MAX_FULL = {"x": 0.2, "y": 0.2, "z": 0.2, "insertion": 0.2, "yaw": 1.5, "pitch": 1.5, "roll": 3.0}
MAX_FULL |= {"tilt_x": 3.0, "tilt_y": 3.0}
"""Largest speed at full deflection [m/s, rad/s]; guards against typing errors. The arm's own limits
hold in any case."""
MAX_DEAD_ZONE = 0.5
MAX_GRIP_SPEED = 5.0
"""[1/s] From closed to open in 0.2 s; the jaw's own limit holds in any case."""
RATES = (5.0, 200.0)
"""[Hz] Allowed autorepeat; below 10 Hz receivers with a timeout of 100 ms see silence."""


@dataclass(frozen=True)
class Axis:
    """One axis of the device."""

    name: str
    code: int
    label: str  # name in the kernel, such as ``ABS_X``
    sign: float  # -1 reverses it
    relative: bool  # a relative axis that reports a deflection
    one_sided: bool  # it rests at its minimum, a trigger: 0 ... 1 instead of -1 ... 1


@dataclass(frozen=True)
class Button:
    """One key or button: name in the layout, number and name in the kernel."""

    name: str
    code: int
    label: str


@dataclass(frozen=True)
class Grip:
    """Axes or buttons that open and close the jaw, and the speed [1/s] at full press."""

    open: str
    close: str
    speed: float


@dataclass(frozen=True)
class Layout:
    """A layout checked by :func:`read_layout`."""

    file: str
    match: str  # part of the device's name; empty: any device with these axes and buttons
    grab: bool  # take the device's events exclusively
    dead_zone: float  # half width of the zone around an axis' middle that counts as 0
    autorepeat: float  # rate of Joy while nothing changes [Hz]
    axes: tuple[Axis, ...]  # in the order of Joy.axes
    buttons: tuple[Button, ...]  # in the order of Joy.buttons
    hand: dict[str, tuple[str, float]]  # axis and full speed by name of VIEW or VIRTUAL_JOINTS
    grip: Grip | None
    dead_man: str | None  # button that must be held to move; None: reported elsewhere
    actions: dict[str, str]  # button by action, of BUTTONS
    fail_pressed: frozenset[str]  # actions that count as pressed while the device is missing

    @property
    def spherical(self) -> bool:
        """Whether the hand turns the shaft about the trocar, by the names of `VIRTUAL_JOINTS`."""
        return not self.hand.keys().isdisjoint(VIRTUAL_JOINTS[:3])

    def lacks(self, device: Description) -> list[str]:
        """Missing axes and buttons of a device, such as ``ABS_RX (right_x)``; empty: it fits."""
        lacking = [
            f"{axis.label} ({axis.name})"
            for axis in self.axes
            if axis.code not in (device.relative if axis.relative else device.axes)
        ]
        lacking += [f"{b.label} ({b.name})" for b in self.buttons if b.code not in device.keys]
        return lacking


def bundled() -> tuple[str, ...]:
    """Names of the bundled layouts."""
    return tuple(sorted(file.stem for file in FOLDER.glob("*.yaml")))


def read_layout(name_or_path: str) -> Layout:
    """Read and check a layout.

    Args:
        name_or_path: A name of :func:`bundled`, or the path of a YAML file.

    Raises:
        LeaderError: The file cannot be read, or a value is invalid.
    """
    path = Path(name_or_path)
    if name_or_path in bundled():
        path = FOLDER / f"{name_or_path}.yaml"
    elif path.suffix not in (".yaml", ".yml"):
        raise LeaderError(
            "there is no such layout",
            name_or_path,
            f"there are {', '.join(bundled())}, or the path of a .yaml file",
        )
    try:
        tree = yaml.safe_load(path.read_text("utf-8"))
    except OSError as error:
        raise LeaderError(f"cannot be read: {error.strerror}", str(path), "check it") from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        line = " ".join(str(error).split())
        raise LeaderError(f"is not YAML: {line}", str(path), "correct it") from error
    return _Reader(str(path)).layout(tree)


KEYS = ("format", *(field.name for field in fields(Layout) if field.name != "file"))


class _Reader:
    """Converts a tree of YAML to a Layout."""

    def __init__(self, file: str) -> None:
        self.file = file

    def wrong(self, key: str, value: object, allowed: str) -> LeaderError:
        return LeaderError(f"'{value}'", f"{self.file}: {key}", f"allowed: {allowed}")

    def layout(self, tree: Any) -> Layout:
        top = self.table("the file", tree, KEYS)
        if top.get("format") != FORMAT:
            raise self.wrong("format", top.get("format"), FORMAT)
        axes = tuple(self.axis(name, spec) for name, spec in self.named(top, "axes"))
        buttons = tuple(
            Button(name, self.code(f"buttons.{name}", label, ("BTN", "KEY")), str(label))
            for name, label in self.named(top, "buttons")
        )
        axis_names, button_names = [a.name for a in axes], [b.name for b in buttons]
        twice = sorted(set(axis_names) & set(button_names))
        if twice:
            raise self.wrong("buttons", twice[0], "a name that no axis has")
        hand = self.hand(top, axis_names)
        fail_pressed = top.get("fail_pressed", [])
        actions = {
            action: self.one_of(f"actions.{action}", button, button_names)
            for action, button in self.named(top, "actions", sorted(BUTTONS - {"present"}))
        }
        if not isinstance(fail_pressed, list):
            raise self.wrong("fail_pressed", fail_pressed, "a list of actions")
        for action in fail_pressed:
            self.one_of("fail_pressed", action, list(actions))
        return Layout(
            file=self.file,
            match=str(top.get("match", "")),
            grab=self.truth("grab", top.get("grab", False)),
            dead_zone=self.number("dead_zone", top.get("dead_zone", 0.1), 0.0, MAX_DEAD_ZONE),
            autorepeat=self.number("autorepeat", top.get("autorepeat", 20.0), *RATES),
            axes=axes,
            buttons=buttons,
            hand=hand,
            grip=self.grip(top, [*axis_names, *button_names]),
            dead_man=self.dead_man(top, bool(hand), button_names),
            actions=actions,
            fail_pressed=frozenset(fail_pressed),
        )

    def axis(self, name: str, spec: Any) -> Axis:
        key = f"axes.{name}"
        table = self.table(key, spec, ("code", "sign", "rest"))
        if "code" not in table:
            raise self.wrong(f"{key}.code", None, "the kernel's name of the axis, such as ABS_X")
        label = str(table["code"])
        sign = table.get("sign", 1)
        if sign not in (1, -1) or isinstance(sign, bool):
            raise self.wrong(f"{key}.sign", sign, "1 or -1")
        rest = self.one_of(f"{key}.rest", table.get("rest", "middle"), ["middle", "minimum"])
        return Axis(
            name=name,
            code=self.code(f"{key}.code", label, ("ABS", "REL")),
            label=label,
            sign=float(sign),
            relative=label.startswith("REL"),
            one_sided=rest == "minimum",
        )

    def hand(self, top: dict[str, Any], axes: list[str]) -> dict[str, tuple[str, float]]:
        given = dict(self.named(top, "hand"))
        allowed = VIEW if given.keys().isdisjoint(VIRTUAL_JOINTS[:3]) else VIRTUAL_JOINTS
        hand = {}
        for name, spec in given.items():
            key = f"hand.{name}"
            self.one_of("hand", name, list(allowed))
            table = self.table(key, spec, ("axis", "full"))
            most = MAX_FULL[name]
            full = self.number(f"{key}.full", table.get("full"), -most, most)
            hand[name] = (self.one_of(f"{key}.axis", table.get("axis"), axes), full)
        return hand

    def grip(self, top: dict[str, Any], names: list[str]) -> Grip | None:
        if top.get("grip") is None:
            return None
        table = self.table("grip", top["grip"], ("open", "close", "speed"))
        return Grip(
            open=self.one_of("grip.open", table.get("open"), names),
            close=self.one_of("grip.close", table.get("close"), names),
            speed=self.number("grip.speed", table.get("speed", 1.0), 0.0, MAX_GRIP_SPEED),
        )

    def dead_man(self, top: dict[str, Any], moves: bool, buttons: list[str]) -> str | None:
        """A device that moves the arm has a dead-man switch, or its file names ELSEWHERE."""
        name = top.get("dead_man")
        if name == ELSEWHERE or (name is None and not moves):
            return None
        return self.one_of("dead_man", name, [*buttons, ELSEWHERE])

    def table(self, key: str, value: Any, allowed: tuple[str, ...]) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise self.wrong(key, value, f"keys and values: {', '.join(allowed)}")
        for unknown in value.keys() - set(allowed):
            raise self.wrong(key, unknown, ", ".join(allowed))
        return value

    def named(
        self, top: dict[str, Any], key: str, allowed: list[str] | None = None
    ) -> list[tuple[str, Any]]:
        value = top.get(key, {})
        if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
            raise self.wrong(key, value, "names (in quotes where YAML sees no text) with a value")
        for name in value:
            if allowed is not None:
                self.one_of(key, name, allowed)
        return list(value.items())

    def one_of(self, key: str, value: object, allowed: list[str]) -> str:
        if not isinstance(value, str) or value not in allowed:
            raise self.wrong(key, value, ", ".join(allowed) or "nothing: the file names none")
        return value

    def code(self, key: str, label: object, kinds: tuple[str, ...]) -> int:
        code = ecodes.ecodes.get(label) if isinstance(label, str) else None
        if not isinstance(code, int) or not str(label).startswith(kinds):
            raise self.wrong(
                key, label, f"the kernel's name, {' or '.join(k + '_…' for k in kinds)}"
            )
        return code

    def number(self, key: str, value: object, low: float, high: float) -> float:
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not (good and math.isfinite(float(str(value))) and low <= float(str(value)) <= high):
            raise self.wrong(key, value, f"a number from {low:g} to {high:g}")
        return float(str(value))

    def truth(self, key: str, value: object) -> bool:
        if not isinstance(value, bool):
            raise self.wrong(key, value, "true or false")
        return value
