"""From parameters to hands on arms: the cell is read and leaders are made, nothing is opened."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import surg_core
from surg_core import ConfigError
from surg_teleop.follow.arm_switch import Seat
from surg_teleop.follow.arm_view import Jaw
from surg_teleop.follow.endoscope_pose import HeldCamera, held_camera
from surg_teleop.follow.servo_instrument import VirtualArm
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.follow.teleoperation import CameraView, Kind, Teleop, TeleopSettings
from surg_teleop.leaders import leader as leaders
from surg_teleop.leaders.bundled.crtk import CrtkLeader
from surg_teleop.leaders.leader import Leader, LeaderError, LeaderSample
from surg_teleop.playback.workspace_fit import Workspace

Array = NDArray[np.float64]

REOPEN = 1.0
"""[s] A lost device is looked for that often."""
ASSISTANT = "assistant"
"""Name of the instrument that has no controller."""
ASSISTANT_RANGE = (0.03, 0.23, 1.0)
"""Depth from, to [m] and cone [rad] of the assistant's instrument: inside its servos' range."""
SEAT_KEYS = ("leader", "settings", "arm", "mapping", "scale", "need_present")
KEYS = {"cell", "view", "picture", "lockstep", "enabled", "duration", "assistant_frame"} | {
    prefix + key for prefix in ("", "second_") for key in SEAT_KEYS
}
"""Parameters that there are."""


@dataclass
class Hand:
    """A leader in its seat.

    Attributes:
        leader: The device.
        seat: What follows it.
        problem: Why the leader cannot be read; empty: it can.
        retry: When it is opened again [s].
        buttons: Those that were down last.
    """

    leader: Leader
    seat: Seat
    problem: str = "it has not been opened yet"
    retry: float = -math.inf
    buttons: frozenset[str] = frozenset()

    def read(self, now: float) -> LeaderSample | None:
        """The newest sample; a lost device is opened again once in a while."""
        try:
            if self.problem:
                if now < self.retry:
                    return None
                self.leader.open()
                self.problem = ""
            return self.leader.read(now)
        except Exception as error:
            # A leader of one's own may raise anything: what follows it must be let go all the same.
            known = isinstance(error, LeaderError)
            self.problem = str(error) if known else f"{type(error).__name__}: {error}"
            self.retry = now + REOPEN
            with contextlib.suppress(Exception):
                self.leader.close()
            return None

    def pressed(self, sample: LeaderSample | None) -> frozenset[str]:
        """Buttons that have just gone down."""
        now = sample.buttons if sample is not None else self.buttons
        new, self.buttons = now - self.buttons, now
        return new


@dataclass
class System:
    """What the parameters describe.

    Attributes:
        hands: Leaders in their seats.
        bases: (3, 3) base in the world of every arm that a hand may hold.
        camera: An endoscope that an arm holds, or the view of one that stands.
        assistant: The assistant's instrument, where a hand holds it.
        picture: Topic of the picture that is watched; empty: none.
        lockstep: Every tick is answered with Ready.
        duration: Of a lock-step run [s]; 0: no end.
    """

    hands: list[Hand]
    bases: dict[str, Array]
    camera: HeldCamera | CameraView
    assistant: VirtualArm | None
    picture: str
    lockstep: bool
    duration: float

    @property
    def heard(self) -> list[str]:
        """Arms whose cycles are looked at."""
        held = [self.camera.arm] if isinstance(self.camera, HeldCamera) else []
        return list(dict.fromkeys([*self.bases, *held]))


def read_system(parameters: dict[str, Any], node: str) -> System:
    """Reads the cell and makes the leaders; nothing is opened yet.

    Raises:
        ConfigError: The cell or a parameter must not be used.
        LeaderError: There is no such leader.
    """
    unknown = sorted(set(parameters) - KEYS)
    if unknown:
        raise ConfigError(
            f"teleop: parameter {', '.join(unknown)} is unknown; allowed: {_names(KEYS)}"
        )
    for needed in ("cell", "leader"):
        if needed not in parameters:
            raise ConfigError(f"teleop: parameter ~{needed} is missing")
    cell = surg_core.load_cell(str(parameters["cell"]))
    camera = held_camera(cell) or _standing(parameters, cell)
    assistant, hands, bases = None, [], {}
    for prefix in ("", "second_"):
        if prefix + "leader" not in parameters:
            continue
        arm = str(parameters.get(prefix + "arm", "" if prefix else "PSM1"))
        if arm == ASSISTANT:
            q = _numbers(parameters, "assistant_frame", 4)
            assistant = VirtualArm(node, surg_core.quaternion_xyzw_to_matrix(q))
        elif arm not in cell.arms or cell.arms[arm].instrument.camera is not None:
            instruments = [a.name for a in cell.arms.values() if a.instrument.camera is None]
            raise ConfigError(
                f"teleop: ~{prefix}arm: '{arm}'; allowed: {_names([*instruments, ASSISTANT])}"
            )
        elif arm in bases:
            raise ConfigError(f"teleop: ~{prefix}arm: {arm} is held by the first hand already")
        else:
            bases[arm] = cell.arms[arm].X_WB[:3, :3]
        hand = _hand(parameters, prefix, cell, arm, node)
        if not prefix and isinstance(camera, HeldCamera):
            endoscope = _teleop(hand.leader, cell, camera.arm, node, parameters, prefix)
            endoscope.lock_rotation = True  # the horizon stays
            hand.seat.endoscope = endoscope
            bases[camera.arm] = cell.arms[camera.arm].X_WB[:3, :3]
        hands.append(hand)
    lockstep = bool(parameters.get("lockstep", False))
    if lockstep and any(isinstance(hand.leader, CrtkLeader) for hand in hands):
        raise ConfigError("teleop: ~lockstep: true with a leader on topics; allowed: false")
    if parameters.get("enabled") and not lockstep:
        raise ConfigError("teleop: ~enabled: true; allowed: in lock-step only, where nobody could")
    for hand in hands if parameters.get("enabled") else ():
        hand.seat.enable()
    return System(
        hands=hands,
        bases=bases,
        camera=camera,
        assistant=assistant,
        picture=str(parameters.get("picture", "/endoscope/left/image_raw")),
        lockstep=lockstep,
        duration=_number(parameters, "duration", 0.0),
    )


def _standing(parameters: dict[str, Any], cell: surg_core.Cell) -> CameraView:
    if "view" not in parameters:
        raise ConfigError(
            f"teleop: no arm of cell {cell.config.name} holds an endoscope; ~view is needed: the "
            "orientation x, y, z, w of the left eye (x right, y down, z away) in the world"
        )
    return CameraView(surg_core.quaternion_xyzw_to_matrix(_numbers(parameters, "view", 4)))


def _hand(
    parameters: dict[str, Any], prefix: str, cell: surg_core.Cell, arm: str, node: str
) -> Hand:
    settings = parameters.get(prefix + "settings", {})
    if not isinstance(settings, dict):
        raise ConfigError(f"teleop: ~{prefix}settings: {settings!r}; allowed: a mapping")
    leader = leaders.load(str(parameters[prefix + "leader"]), settings)
    return Hand(leader, Seat(_teleop(leader, cell, arm, node, parameters, prefix)))


def _teleop(
    leader: Leader,
    cell: surg_core.Cell,
    arm: str,
    node: str,
    parameters: dict[str, Any],
    prefix: str,
) -> Teleop:
    kinds = [kind.value for kind in Kind]
    kind = str(parameters.get(prefix + "mapping", getattr(leader, "mapping", Kind.POSITION.value)))
    if kind not in kinds:
        raise ConfigError(f"teleop: ~{prefix}mapping: '{kind}'; allowed: {_names(kinds)}")
    # The assistant's servos are as fast as the arms' limits; its jaws are the first arm's.
    model = cell.arms.get(arm) or next(iter(cell.arms.values()))
    limits, instrument = model.limits, model.instrument
    workspace = Workspace(limits.depth_slow, limits.depth_max, limits.cone)
    if arm == ASSISTANT:
        workspace = Workspace(*ASSISTANT_RANGE)
    jaw = None
    if instrument.camera is None and instrument.jaw_max > instrument.jaw_min:
        jaw = Jaw(instrument.jaw_min, instrument.jaw_max)
    teleop = Teleop(
        TeleopSettings(
            leader=leader.name,
            arm=arm,
            node=node,
            workspace=workspace,
            step=StepLimits(
                velocity=limits.tip_velocity,
                slack=limits.step_slack,
                roll_velocity=limits.roll_velocity,
                roll_slack=limits.step_roll_slack,
                longest=limits.step_dt_max,
            ),
            quiet=model.robot.tuning.servo_timeout + 0.05,
            jaw=jaw,
            jaw_velocity=instrument.jaw_velocity if jaw else 0.0,
            kind=Kind(kind),
            need_present=bool(parameters.get(prefix + "need_present", False)),
        )
    )
    if refused := teleop.set_scale(_number(parameters, prefix + "scale", teleop.scale)):
        raise ConfigError(f"teleop: ~{prefix}scale: {refused}")
    return teleop


def _number(parameters: dict[str, Any], name: str, default: float) -> float:
    value = parameters.get(name, default)
    try:
        return float(str(value))
    except ValueError as error:
        raise ConfigError(f"teleop: ~{name}: '{value}'; allowed: a number") from error


def _numbers(parameters: dict[str, Any], name: str, n: int) -> Array:
    value = parameters.get(name)
    try:
        numbers = np.asarray(value, dtype=np.float64)
        if numbers.shape != (n,) or not np.isfinite(numbers).all() or not numbers.any():
            raise ValueError
    except (TypeError, ValueError) as error:
        raise ConfigError(f"teleop: ~{name}: {value!r}; needed: {n} numbers, x, y, z, w") from error
    return numbers


def _names(names: Iterable[str]) -> str:
    return ", ".join(sorted(names))
