"""Reads the node's parameters: the cell is loaded and leaders are made, but no device is opened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import surg_core
from surg_core.arm_view import Array, JawRange
from surg_core.held_endoscope import HeldEndoscope, held_endoscope
from surg_ros.params import ParamError, dictionary, flag, one_of, read, real, text, vector
from surg_teleop.follow.arm_switch import ArmSwitch, Hand
from surg_teleop.follow.servo_instrument import ServoInstrument
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.follow.teleop_types import (
    MAX_SCALE,
    MIN_SCALE,
    CameraView,
    ControlMode,
    TeleopSettings,
)
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.leaders import leader as leaders
from surg_teleop.leaders.leader import Leader
from surg_teleop.playback.workspace_fit import Workspace

ASSISTANT = "assistant"
"""Name of the instrument without a controller."""
ASSISTANT_RANGE = (0.03, 0.23, 1.0)
"""Depth from, to [m] and cone [rad] of the assistant's instrument, inside the servos' range."""
MODES = tuple(mode.value for mode in ControlMode)


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node; those of the second hand begin with ``second_``."""

    cell: str = text()
    view: tuple[float, ...] | None = vector(4, None, meaning="x, y, z, w")
    picture: str = text("/endoscope/left/image_raw", empty=True)
    haptics: bool = flag(False)
    assistant_frame: tuple[float, ...] | None = vector(4, None, meaning="x, y, z, w")
    leader: str = text()
    settings: dict[str, Any] = dictionary()
    arm: str = text("PSM1")
    mapping: str = one_of(MODES, "")
    scale: float | None = real(MIN_SCALE, MAX_SCALE, None)
    need_present: bool = flag(False)
    second_leader: str = text("", empty=True)
    second_settings: dict[str, Any] = dictionary()
    second_arm: str = text("", empty=True)
    second_mapping: str = one_of(MODES, "")
    second_scale: float | None = real(MIN_SCALE, MAX_SCALE, None)
    second_need_present: bool = flag(False)

    def of(self, prefix: str, name: str) -> Any:
        """A parameter of one hand."""
        return getattr(self, prefix + name)


@dataclass
class TeleopSetup:
    """What the parameters describe."""

    hands: list[Hand]
    bases: dict[str, Array]  # (3, 3) base in the world of every arm that a leader may drive
    camera: HeldEndoscope | CameraView  # an endoscope held by an arm, or a fixed view
    assistant: ServoInstrument | None  # the assistant's instrument, if a leader drives it
    picture: str  # topic of the supervised picture; empty: none
    haptics: bool = False  # the forces at the tips go to the leaders

    @property
    def heard(self) -> list[str]:
        """Arms whose cycles are needed."""
        held = [self.camera.arm] if isinstance(self.camera, HeldEndoscope) else []
        return list(dict.fromkeys([*self.bases, *held]))


def read_setup(parameters: dict[str, Any], node: str) -> TeleopSetup:
    """Read the parameters, load the cell and make the leaders.

    Raises:
        ParamError: A parameter is invalid.
        ConfigError: The cell is invalid.
        LeaderError: There is no such leader.
    """
    given = read(Parameters, parameters)
    cell = surg_core.load_cell(given.cell)
    setup = TeleopSetup(
        hands=[],
        bases={},
        camera=held_endoscope(cell) or _fixed_view(given, cell),
        assistant=None,
        picture=given.picture,
        haptics=given.haptics,
    )
    for prefix in ("", "second_"):
        if given.of(prefix, "leader"):
            _add_hand(setup, given, prefix, cell, node)
    return setup


def _add_hand(
    setup: TeleopSetup, given: Parameters, prefix: str, cell: surg_core.Cell, node: str
) -> None:
    """Add a leader; the first one also drives the endoscope, where an arm holds it."""
    arm = given.of(prefix, "arm")
    if arm == ASSISTANT:
        if given.assistant_frame is None:
            raise ParamError("assistant_frame", None, "4 numbers: x, y, z, w")
        R_WR = surg_core.quaternion_xyzw_to_matrix(given.assistant_frame)
        setup.assistant = ServoInstrument(node, R_WR)
    elif arm not in cell.arms or cell.arms[arm].instrument.camera is not None:
        instruments = [a.name for a in cell.arms.values() if a.instrument.camera is None]
        raise ParamError(prefix + "arm", arm, ", ".join(sorted([*instruments, ASSISTANT])))
    elif arm in setup.bases:
        raise ParamError(prefix + "arm", arm, "an arm that the first leader does not drive")
    else:
        setup.bases[arm] = cell.arms[arm].X_WB[:3, :3]
    leader = leaders.load(given.of(prefix, "leader"), given.of(prefix, "settings"))
    switch = ArmSwitch(_teleop(leader, cell, arm, node, given, prefix))
    camera = setup.camera
    if not prefix and isinstance(camera, HeldEndoscope):
        switch.endoscope = _teleop(leader, cell, camera.arm, node, given, prefix)
        switch.endoscope.lock_rotation = True  # keeps the horizon
        setup.bases[camera.arm] = cell.arms[camera.arm].X_WB[:3, :3]
    setup.hands.append(Hand(leader, switch))


def _fixed_view(given: Parameters, cell: surg_core.Cell) -> CameraView:
    if given.view is None:
        raise ParamError(
            "view",
            None,
            f"the orientation x, y, z, w of the left eye (x right, y down, z away) in the world, "
            f"because no arm of cell {cell.config.name} holds an endoscope",
        )
    return CameraView(surg_core.quaternion_xyzw_to_matrix(given.view))


def _teleop(
    leader: Leader,
    cell: surg_core.Cell,
    arm: str,
    node: str,
    given: Parameters,
    prefix: str,
) -> Teleop:
    mode = given.of(prefix, "mapping") or getattr(leader, "mapping", ControlMode.POSITION.value)
    if mode not in MODES:
        raise ParamError(prefix + "mapping", mode, f"{', '.join(MODES)}; this is the leader's own")
    # The assistant's servos are as fast as the arms' limits; its jaws are those of the first arm.
    model = cell.arms.get(arm) or next(iter(cell.arms.values()))
    limits, instrument = model.limits, model.instrument
    workspace = Workspace(limits.depth_slow, limits.depth_max, limits.cone)
    depth_inserted = limits.depth_min
    if arm == ASSISTANT:
        workspace, depth_inserted = Workspace(*ASSISTANT_RANGE), 0.0
    wrist = None if arm == ASSISTANT else instrument.wrist
    jaw = None
    if instrument.camera is None and instrument.jaw_max > instrument.jaw_min:
        jaw = JawRange(instrument.jaw_min, instrument.jaw_max)
    settings = TeleopSettings(
        leader=leader.name,
        arm=arm,
        node=node,
        workspace=workspace,
        step=StepLimits.of(limits, wrist.velocity if wrist else 0.0),
        depth_inserted=depth_inserted,
        quiet=model.robot.tuning.servo_timeout + 0.05,
        jaw=jaw,
        jaw_velocity=instrument.jaw_velocity if jaw else 0.0,
        mode=ControlMode(mode),
        need_present=given.of(prefix, "need_present"),
        wrist=wrist,
        roll_max=limits.roll_max,
    )
    teleop = Teleop(settings)
    teleop.scale = given.of(prefix, "scale") or teleop.scale
    return teleop
