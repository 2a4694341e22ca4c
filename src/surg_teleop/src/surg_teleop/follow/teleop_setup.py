"""Reads the node's parameters: the cell is loaded and leaders are made, but no device is opened."""

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
from surg_core.arm_view import JawRange
from surg_teleop.follow.arm_switch import ArmSwitch
from surg_teleop.follow.endoscope_pose import HeldCamera, held_camera
from surg_teleop.follow.servo_instrument import ServoInstrument
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.follow.teleop_types import CameraView, ControlMode, TeleopSettings
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.leaders import leader as leaders
from surg_teleop.leaders.bundled.crtk import CrtkLeader
from surg_teleop.leaders.leader import Leader, LeaderError, LeaderSample
from surg_teleop.playback.workspace_fit import Workspace

Array = NDArray[np.float64]

REOPEN = 1.0
"""[s] Interval between attempts to open a lost device."""
ASSISTANT = "assistant"
"""Name of the instrument without a controller."""
ASSISTANT_RANGE = (0.03, 0.23, 1.0)
"""Depth from, to [m] and cone [rad] of the assistant's instrument, inside the servos' range."""
HAND_KEYS = ("leader", "settings", "arm", "mapping", "scale", "need_present")
KEYS = {"cell", "view", "picture", "lockstep", "enabled", "duration", "assistant_frame"} | {
    prefix + key for prefix in ("", "second_") for key in HAND_KEYS
}
"""Known parameters."""


@dataclass
class Hand:
    """A leader and the arms that it drives.

    Attributes:
        leader: The device.
        switch: Its arms.
        problem: Why the leader cannot be read; empty if it can.
        retry: Time of the next attempt to open it [s].
        buttons: Those that were down last.
    """

    leader: Leader
    switch: ArmSwitch
    problem: str = "it has not been opened yet"
    retry: float = -math.inf
    buttons: frozenset[str] = frozenset()

    def read(self, now: float) -> LeaderSample | None:
        """The newest sample; a lost device is reopened periodically."""
        try:
            if self.problem:
                if now < self.retry:
                    return None
                self.leader.open()
                self.problem = ""
            return self.leader.read(now)
        except Exception as error:
            # A user's leader may raise anything; its arm must be let go all the same.
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
class TeleopSetup:
    """What the parameters describe.

    Attributes:
        hands: Leaders with their arms.
        bases: (3, 3) base in the world of every arm that a leader may drive.
        camera: An endoscope held by an arm, or a fixed view.
        assistant: The assistant's instrument, if a leader drives it.
        picture: Topic of the supervised picture; empty: none.
        lockstep: Every tick is answered with Ready.
        duration: Of a lock-step run [s]; 0: no end.
    """

    hands: list[Hand]
    bases: dict[str, Array]
    camera: HeldCamera | CameraView
    assistant: ServoInstrument | None
    picture: str
    lockstep: bool
    duration: float

    @property
    def heard(self) -> list[str]:
        """Arms whose cycles are needed."""
        held = [self.camera.arm] if isinstance(self.camera, HeldCamera) else []
        return list(dict.fromkeys([*self.bases, *held]))


def read_setup(parameters: dict[str, Any], node: str) -> TeleopSetup:
    """Read the parameters, load the cell and make the leaders.

    Raises:
        ConfigError: The cell or a parameter is invalid.
        LeaderError: There is no such leader.
    """
    unknown = sorted(set(parameters) - KEYS)
    if unknown:
        raise ConfigError(
            f"teleop: parameter {', '.join(unknown)} is unknown; allowed: {_names(KEYS)}"
        )
    for key in ("cell", "leader"):
        if key not in parameters:
            raise ConfigError(f"teleop: parameter ~{key} is missing")
    cell = surg_core.load_cell(str(parameters["cell"]))
    setup = TeleopSetup(
        hands=[],
        bases={},
        camera=held_camera(cell) or _fixed_view(parameters, cell),
        assistant=None,
        picture=str(parameters.get("picture", "/endoscope/left/image_raw")),
        lockstep=bool(parameters.get("lockstep", False)),
        duration=_number(parameters, "duration", 0.0),
    )
    for prefix in ("", "second_"):
        if prefix + "leader" in parameters:
            _add_hand(setup, parameters, prefix, cell, node)
    enabled = bool(parameters.get("enabled"))
    if setup.lockstep and any(isinstance(hand.leader, CrtkLeader) for hand in setup.hands):
        raise ConfigError("teleop: ~lockstep: true with a leader on topics; allowed: false")
    if enabled and not setup.lockstep:
        raise ConfigError("teleop: ~enabled: true; allowed with ~lockstep: true only")
    for hand in setup.hands if enabled else ():
        hand.switch.enable()
    return setup


def _add_hand(
    setup: TeleopSetup, parameters: dict[str, Any], prefix: str, cell: surg_core.Cell, node: str
) -> None:
    """Add a leader; the first one also drives the endoscope, where an arm holds it."""
    arm = str(parameters.get(prefix + "arm", "" if prefix else "PSM1"))
    if arm == ASSISTANT:
        q = _numbers(parameters, "assistant_frame", 4)
        setup.assistant = ServoInstrument(node, surg_core.quaternion_xyzw_to_matrix(q))
    elif arm not in cell.arms or cell.arms[arm].instrument.camera is not None:
        instruments = [a.name for a in cell.arms.values() if a.instrument.camera is None]
        raise ConfigError(
            f"teleop: ~{prefix}arm: '{arm}'; allowed: {_names([*instruments, ASSISTANT])}"
        )
    elif arm in setup.bases:
        raise ConfigError(f"teleop: ~{prefix}arm: {arm} is driven by the first leader already")
    else:
        setup.bases[arm] = cell.arms[arm].X_WB[:3, :3]
    options = parameters.get(prefix + "settings", {})
    if not isinstance(options, dict):
        raise ConfigError(f"teleop: ~{prefix}settings: {options!r}; allowed: a mapping")
    leader = leaders.load(str(parameters[prefix + "leader"]), options)
    switch = ArmSwitch(_teleop(leader, cell, arm, node, parameters, prefix))
    camera = setup.camera
    if not prefix and isinstance(camera, HeldCamera):
        switch.endoscope = _teleop(leader, cell, camera.arm, node, parameters, prefix)
        switch.endoscope.lock_rotation = True  # keeps the horizon
        setup.bases[camera.arm] = cell.arms[camera.arm].X_WB[:3, :3]
    setup.hands.append(Hand(leader, switch))


def _fixed_view(parameters: dict[str, Any], cell: surg_core.Cell) -> CameraView:
    if "view" not in parameters:
        raise ConfigError(
            f"teleop: no arm of cell {cell.config.name} holds an endoscope; ~view is needed: the "
            "orientation x, y, z, w of the left eye (x right, y down, z away) in the world"
        )
    return CameraView(surg_core.quaternion_xyzw_to_matrix(_numbers(parameters, "view", 4)))


def _teleop(
    leader: Leader,
    cell: surg_core.Cell,
    arm: str,
    node: str,
    parameters: dict[str, Any],
    prefix: str,
) -> Teleop:
    modes = [mode.value for mode in ControlMode]
    default = getattr(leader, "mapping", ControlMode.POSITION.value)
    mode = str(parameters.get(prefix + "mapping", default))
    if mode not in modes:
        raise ConfigError(f"teleop: ~{prefix}mapping: '{mode}'; allowed: {_names(modes)}")
    # The assistant's servos are as fast as the arms' limits; its jaws are those of the first arm.
    model = cell.arms.get(arm) or next(iter(cell.arms.values()))
    limits, instrument = model.limits, model.instrument
    workspace = Workspace(limits.depth_slow, limits.depth_max, limits.cone)
    if arm == ASSISTANT:
        workspace = Workspace(*ASSISTANT_RANGE)
    jaw = None
    if instrument.camera is None and instrument.jaw_max > instrument.jaw_min:
        jaw = JawRange(instrument.jaw_min, instrument.jaw_max)
    settings = TeleopSettings(
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
        mode=ControlMode(mode),
        need_present=bool(parameters.get(prefix + "need_present", False)),
    )
    teleop = Teleop(settings)
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
