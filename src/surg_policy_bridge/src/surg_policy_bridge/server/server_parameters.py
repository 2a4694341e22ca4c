"""Parameters of the model server, checked once. No ROS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from surg_policy_bridge.server import listen_address
from surg_policy_bridge.server.safety_controller import CLIPPABLE, CLIPPED
from surg_policy_client.spec import MAX_TEXT
from surg_policy_client.wire import MAX_PARTS, MAX_SENTENCE

MODES = ("lockstep", "freerun")
ADDRESS = "tcp://127.0.0.1:5555"
Get = Callable[[str, Any], Any]
"""Reads a private parameter: (name without ~, default) -> value."""


class SettingsError(ValueError):
    """An invalid parameter: name, value and what is allowed."""


@dataclass(frozen=True)
class Settings:
    """Parameters of the node ``/policy``.

    Attributes:
        bind: Address at which policies connect.
        keys: Folder of `./surg keys`; empty: none, which allows this machine only.
        cell: Path of the cell.
        arms: Arms that the policy commands, in the order of the action.
        mode: ``lockstep`` or ``freerun``.
        task: Name of the task, for the specification.
        instruction: The task in words, for the policy.
        privileged: Serve the simulator's ground truth (``privileged.task_state``).
        cameras: Observed cameras, such as ``endoscope_left``.
        camera_rate: Pictures per second [1/s].
        clip: Rules that clip a step instead of rejecting it.
        autostart: Enable every new session at once.
        need_present: Run only while the operator is at the controls (operator_present of the
            console or the foot pedals, repeated 20 times per second).
        answer_timeout: Longest wall-clock wait for an answer in lock-step [s].
    """

    bind: str
    keys: str
    cell: str
    arms: tuple[str, ...]
    mode: str
    task: str
    instruction: str
    privileged: bool
    cameras: tuple[str, ...]
    camera_rate: float
    clip: tuple[str, ...]
    autostart: bool
    need_present: bool
    answer_timeout: float

    @property
    def lockstep(self) -> bool:
        """Whether it runs in lock-step with the simulator."""
        return self.mode == "lockstep"

    @classmethod
    def read(cls, get: Get) -> Settings:
        """Read and check all parameters.

        Raises:
            SettingsError: A parameter is missing or invalid.
        """
        clip = _texts("clip", get("clip", list(CLIPPED)))
        if unknown := [rule for rule in clip if rule not in CLIPPABLE]:
            raise SettingsError(
                f"parameter ~clip has {unknown}: allowed are {', '.join(CLIPPABLE)}"
            )
        mode = get("mode", "freerun")
        if mode not in MODES:
            raise SettingsError(f"parameter ~mode is {mode!r}: allowed are {', '.join(MODES)}")
        cell = get("cell", "")
        if not isinstance(cell, str) or not cell:
            raise SettingsError(f"parameter ~cell is {cell!r}: the folder of a cell")
        keys = _word("keys", get("keys", ""))
        try:
            bind = listen_address.check(_word("bind", get("bind", ADDRESS)), bool(keys))
        except listen_address.BindError as error:
            raise SettingsError(f"parameter ~bind: {error}") from error
        privileged = _flag("privileged", get("privileged", False))
        cameras = _texts("cameras", get("cameras", []))
        most = MAX_PARTS - 2 - privileged  # beside the header and the arms' state
        if len(cameras) > most:
            raise SettingsError(
                f"parameter ~cameras names {len(cameras)}: at most {most} are served"
            )
        return cls(
            bind=bind,
            keys=keys,
            cell=cell,
            arms=_texts("arms", get("arms", ["PSM1"])) or ("PSM1",),
            mode=mode,
            task=_word("task", get("task", ""), MAX_TEXT),
            instruction=_word("instruction", get("instruction", ""), MAX_SENTENCE),
            privileged=privileged,
            cameras=cameras,
            camera_rate=_real("camera_rate", get("camera_rate", 20.0), 1.0, 240.0),
            clip=clip,
            autostart=_flag("autostart", get("autostart", False)),
            need_present=_flag("need_present", get("need_present", False)),
            answer_timeout=_real("answer_timeout", get("answer_timeout", 5.0), 0.1, 9.0),
        )

    def check_arms(self, names: Sequence[str], links: Sequence[str]) -> None:
        """Check the arms against the cell.

        Args:
            names: Arms of the cell.
            links: Robot link of each, such as ``simulator``.

        Raises:
            SettingsError: An arm is unknown, or a real arm has no ground truth.
        """
        link_of = dict(zip(names, links, strict=True))
        if unknown := [arm for arm in self.arms if arm not in link_of]:
            raise SettingsError(
                f"parameter ~arms names {', '.join(unknown)}: the cell has {', '.join(link_of)}"
            )
        real = [arm for arm in self.arms if link_of[arm] != "simulator"]
        if self.privileged and real:
            raise SettingsError(
                f"parameter ~privileged is true, but {', '.join(real)} is not simulated: only the "
                "simulator has ground truth"
            )


def _word(name: str, value: Any, most: int | None = None) -> str:
    if not isinstance(value, str):
        raise SettingsError(f"parameter ~{name} is {value!r}: give a text")
    if most is not None and len(value) > most:
        raise SettingsError(f"parameter ~{name} has {len(value)} characters: at most {most}")
    return value


def _texts(name: str, value: Any) -> tuple[str, ...]:
    """A list of names, or one string with commas (what a rosrun line can pass)."""
    items = value.split(",") if isinstance(value, str) else value
    if not isinstance(items, list) or not all(isinstance(item, str) for item in items):
        raise SettingsError(f"parameter ~{name} is {value!r}: give a list of names, or 'a,b'")
    names = tuple(item.strip() for item in items if item.strip())
    if twice := sorted({item for item in names if names.count(item) > 1}):
        raise SettingsError(f"parameter ~{name} names {', '.join(twice)} twice: once is allowed")
    return names


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise SettingsError(f"parameter ~{name} is {value!r}: true or false is allowed")
    return value


def _real(name: str, value: Any, low: float, high: float) -> float:
    number = not isinstance(value, bool) and isinstance(value, int | float)
    if not number or not low <= value <= high:
        raise SettingsError(f"parameter ~{name} is {value!r}: {low:g} to {high:g} is allowed")
    return float(value)
