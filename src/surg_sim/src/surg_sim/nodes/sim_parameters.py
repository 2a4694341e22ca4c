"""The bridge's and the endoscope's parameters: checked once, then frozen. No ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from surg_sim.nodes.lockstep import OBSERVER_WINDOWS

MODES = ("lockstep", "freerun")
VIEWS = (("left",), ("left", "right"))
"""Which views an endoscope can be asked for."""
DEFAULT_SETTING = "phantom"
"""The physical setting of a task that names none."""


class SettingsError(ValueError):
    """A parameter that must not be used: name, value, what is allowed."""


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise SettingsError(f"parameter ~{name} is {value!r}: give a non-empty string")
    return value


def _word(name: str, value: Any) -> str:
    """A text that may be empty."""
    if not isinstance(value, str):
        raise SettingsError(f"parameter ~{name} is {value!r}: give a text, or none")
    return value


def _texts(name: str, value: Any) -> tuple[str, ...]:
    """A list of names, or one string with commas (what a rosrun line can pass)."""
    items: Iterable[Any] = value.split(",") if isinstance(value, str) else value
    if not isinstance(items, list):
        raise SettingsError(f"parameter ~{name} is {value!r}: give a list of names, or 'a,b'")
    stripped = [item.strip() if isinstance(item, str) else item for item in items]
    return tuple(_text(name, item) for item in stripped if item != "")


def _whole(name: str, value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise SettingsError(
            f"parameter ~{name} is {value!r}: a whole number from {low} to {high} is allowed"
        )
    return value


def _real(name: str, value: Any, low: float, high: float) -> float:
    number = not isinstance(value, bool) and isinstance(value, int | float)
    if not number or not low <= value <= high:
        raise SettingsError(f"parameter ~{name} is {value!r}: {low} to {high} is allowed")
    return float(value)


def _mode(value: Any) -> str:
    if value not in MODES:
        raise SettingsError(f"parameter ~mode is {value!r}: allowed are {', '.join(MODES)}")
    return str(value)


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise SettingsError(f"parameter ~{name} is {value!r}: true or false is allowed")
    return value


Get = Callable[[str, Any], Any]
"""Looks a private parameter up: (name without ~, default) -> value."""


@dataclass(frozen=True)
class BridgeSettings:
    """Parameters of the node ``/sim``.

    Attributes:
        cell: Path of the cell.
        mode: ``lockstep`` or ``freerun``.
        participants: Declared commanders, waited for in every tick.
        observers: Which of recorder and endoscope take part.
        arms: Arms to simulate; empty: all of the cell.
        seed: Seed of the world.
        view: Open a viewer window where there is a display.
        track_stale: The simulator tracks the trocars and publishes ``rcm/track``, this old [s];
            -1: it does not. In lock-step the controller must have ``sim`` among its participants.
        task: Name or file of the task that is played; empty: none.
        setting: Name of the physical setting; empty: the simulator's own parameters.
        endless: Free-run: the phantom goes on when its task is over, for people who try again.
        faults: Faults from the start, as JSON (``faults``).
        inject: Take further faults on ``/sim/inject``.
        connect_timeout: Longest wait for everybody to connect in lock-step [s].
        abort_timeout: Longest wait for the answer to a tick in lock-step [s].
    """

    cell: str
    mode: str
    participants: tuple[str, ...]
    observers: tuple[str, ...]
    arms: tuple[str, ...]
    seed: int
    view: bool
    track_stale: float
    task: str
    setting: str
    endless: bool
    faults: str
    inject: bool
    connect_timeout: float
    abort_timeout: float

    @classmethod
    def read(cls, get: Get) -> BridgeSettings:
        """Read and check all parameters.

        Raises:
            SettingsError: One is missing or out of range.
        """
        observers = _texts("observers", get("observers", []))
        strangers = [name for name in observers if name not in OBSERVER_WINDOWS]
        if strangers:
            raise SettingsError(
                f"parameter ~observers names {strangers}: allowed are {', '.join(OBSERVER_WINDOWS)}"
            )
        task = _word("task", get("task", ""))
        return cls(
            cell=_text("cell", get("cell", "")),
            mode=_mode(get("mode", "lockstep")),
            participants=_texts("participants", get("participants", [])),
            observers=observers,
            arms=_texts("arms", get("arms", [])),
            seed=_whole("seed", get("seed", 0), 0, 2**31 - 1),
            view=_flag("view", get("view", False)),
            track_stale=_real("track_stale", get("track_stale", -1), -1.0, 1.0),
            task=task,
            setting=_word("setting", get("setting", DEFAULT_SETTING if task else "")),
            endless=_flag("endless", get("endless", False)),
            faults=_word("faults", get("faults", "")),
            inject=_flag("inject", get("inject", False)),
            connect_timeout=_real("connect_timeout", get("connect_timeout", 60.0), 1.0, 3600.0),
            abort_timeout=_real("abort_timeout", get("abort_timeout", 10.0), 1.0, 600.0),
        )


@dataclass(frozen=True)
class EndoscopeSettings:
    """Parameters of the node ``/endoscope``.

    Attributes:
        cell: Path of the cell, the same as the bridge's.
        mode: ``lockstep`` (every snapshot) or ``freerun`` (the newest one only).
        arms: As for the bridge.
        seed: As for the bridge: it draws the tissue.
        task: As for the bridge.
        setting: As for the bridge.
        views: Which of ``left`` and ``right`` are rendered.
        width: [px].
        height: [px].
        vignette: Draw the round edge of an endoscope's picture.
    """

    cell: str
    mode: str
    arms: tuple[str, ...]
    seed: int
    task: str
    setting: str
    views: tuple[str, ...]
    width: int
    height: int
    vignette: bool

    @classmethod
    def read(cls, get: Get) -> EndoscopeSettings:
        """Read and check all parameters.

        Raises:
            SettingsError: One is missing or out of range.
        """
        views = _texts("views", get("views", ["left"]))
        if views not in VIEWS:
            allowed = " or ".join(",".join(each) for each in VIEWS)
            raise SettingsError(f"parameter ~views is {list(views)}: allowed are {allowed}")
        task = _word("task", get("task", ""))
        return cls(
            cell=_text("cell", get("cell", "")),
            mode=_mode(get("mode", "lockstep")),
            arms=_texts("arms", get("arms", [])),
            seed=_whole("seed", get("seed", 0), 0, 2**31 - 1),
            task=task,
            setting=_word("setting", get("setting", DEFAULT_SETTING if task else "")),
            views=views,
            width=_whole("width", get("width", 640), 16, 1920),
            height=_whole("height", get("height", 480), 16, 1080),
            vignette=_flag("vignette", get("vignette", True)),
        )


@dataclass(frozen=True)
class SenderSettings:
    """Parameters of a scripted sender.

    Attributes:
        cell: Path of the cell, the same as the bridge's.
        task: As for the bridge.
        seed: Of the sender's imperfections.
    """

    cell: str
    task: str
    seed: int

    @classmethod
    def read(cls, get: Get) -> SenderSettings:
        """Read and check all parameters.

        Raises:
            SettingsError: One is missing or out of range.
        """
        return cls(
            cell=_text("cell", get("cell", "")),
            task=_text("task", get("task", "")),
            seed=_whole("seed", get("seed", 0), 0, 2**31 - 1),
        )
