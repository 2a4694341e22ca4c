"""An arm as its clients see it: what it reports in a cycle, and what they may command.

Values only: no ROS, no clock. Frames: B robot base, R trocar frame (rcm), W world of the cell; see
docs/reference/conventions.md. Commands are in R.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from surg_core._core import State as ArmState
from surg_core._core import reason_name
from surg_core.contract import POSITION_STREAMS
from surg_core.transforms import matrix_to_quaternion_xyzw, tip_quaternion, virtual_joints
from surg_core.wrist_joints import WristView

if TYPE_CHECKING:
    from surg_core._core import Outputs, WristGeometry

Array = npt.NDArray[np.float64]

ROUNDING = 1e-6
"""[m] What the arithmetic of a sender may add to a step; float32 adds 1e-8 m."""
MARGIN = 1e-9
"""[m] Distance that a shortened step keeps from its limit."""


@dataclass(frozen=True)
class ArmView:
    """One control cycle of an arm. Every member is that of surg_msgs/Cycle, bit for bit.

    Attributes:
        stamp_ns: Stamp of the cycle [ns].
        state: Operating state.
        homed: The trocar frame is known.
        busy: A move is under way.
        reason: Why the arm is PAUSED, in FAULT or held; empty otherwise.
        refused: Number of commands refused so far.
        accepted: Number of commands accepted so far.
        p_BTip: (3,) measured tip [m].
        p_BSet: (3,) set-point of the tip [m].
        s_B: (3,) shaft axis, from the flange to the tip.
        roll: Measured roll [rad].
        roll_set: Set-point of the roll [rad].
        jaw: Measured jaw angle [rad]; NaN: unknown.
        jaw_set: Set-point of the jaw [rad]; NaN: unknown.
        rcm_error: Distance of the shaft from its pivot [m].
        p_BRcm: (3,) pivot [m].
        R_BR: (3, 3) orientation of the trocar frame; None: the source does not report it.
        R_WB: (3, 3) orientation of the base.
        holder: Caller id of the node that holds the arm; empty: none.
        stream: Caller id of the node whose servo_cp the arm obeys; empty: none.
        received: Receipt on the reader's steady clock [s].
        p_BSample: (3,) newest sample of the stream of poses that the arm obeys [m]; None: it obeys
            none.
        roll_sample: Its roll [rad].
        depth: Insertion of the shaft's end [m].
        wrist: None: the instrument is straight.
    """

    stamp_ns: int
    state: ArmState
    homed: bool
    busy: bool
    reason: str
    refused: int
    p_BTip: Array
    p_BSet: Array
    s_B: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    roll: float = 0.0
    roll_set: float = 0.0
    jaw: float = math.nan
    jaw_set: float = math.nan
    rcm_error: float = 0.0
    p_BRcm: Array = field(default_factory=lambda: np.zeros(3))
    accepted: int = 0
    R_BR: Array | None = None
    R_WB: Array = field(default_factory=lambda: np.eye(3))
    holder: str = ""
    stream: str = ""
    received: float = 0.0
    p_BSample: Array | None = None
    roll_sample: float = 0.0
    depth: float = 0.0
    wrist: WristView | None = None

    @classmethod
    def of(cls, out: Outputs, R_BR: Array | None = None) -> ArmView:
        """The view of a controller in this process, which does not report ``R_BR`` (3, 3)."""
        return cls(
            stamp_ns=0,
            state=out.state,
            homed=out.homed,
            busy=out.busy,
            reason=reason_name(out.reason) if int(out.reason) else "",
            refused=out.refused,
            accepted=out.accepted,
            p_BTip=np.array(out.p_BTip),
            p_BSet=np.array(out.p_set),
            s_B=np.array(out.s_B),
            roll=out.roll,
            roll_set=out.roll_set,
            jaw=out.jaw,
            jaw_set=out.jaw_set,
            rcm_error=out.rcm_error,
            p_BRcm=np.array(out.p_BRcm),
            p_BSample=np.array(out.p_goal) if int(out.motion) in POSITION_STREAMS else None,
            roll_sample=out.roll_goal,
            R_BR=R_BR,
            depth=out.depth,
            wrist=None if out.wrist is None else WristView.of(out.wrist),
        )

    @property
    def numbers(self) -> list[float]:
        """The numbers of `contract.ARM_STATE`; behind a wrist of `contract.WRISTED_STATE`."""
        if self.wrist is not None:
            return self._wristed_numbers(self.wrist)
        return [*self.p_tip, self.roll, self.jaw, *self.p_go_on, self.roll_go_on]

    def first_step(self, p: Array, slack: float) -> Array:
        """A stream's first shaft end p (3,) in R [m], within ``slack`` [m] of the set-point.

        Only a step that is too long by its arithmetic is shortened. A step of exactly the slack
        would otherwise be refused by chance.
        """
        way = p - self.p_end
        length = float(np.linalg.norm(way))
        if not slack - MARGIN < length <= slack + ROUNDING:
            return p
        return np.asarray(self.p_end + way * ((slack - MARGIN) / length))

    @property
    def ready(self) -> bool:
        """Whether the arm obeys motion commands."""
        return self.homed and self.state == ArmState.ENABLED

    @cached_property
    def p_tip(self) -> Array:
        """(3,) measured tip in R [m]."""
        return self._in_rcm(self.p_BTip)

    @cached_property
    def p_set(self) -> Array:
        """(3,) set-point of the tip in R [m]."""
        return self._in_rcm(self.p_BSet)

    @cached_property
    def p_end(self) -> Array:
        """(3,) set-point of the shaft's end in R [m]: the tip, or the wrist's centre."""
        if self.wrist is None:
            return self.p_set
        return self.wrist.centre(self.p_set, self.wrist.q_RSet, self.wrist.set)

    @property
    def wrist_geometry(self) -> WristGeometry | None:
        """Lengths and turn of the wrist; None: the instrument is straight."""
        return None if self.wrist is None else self.wrist.geometry

    @property
    def held_target(self) -> Array:
        """The set-point as a target of ``surg_core.action_space``."""
        turns = [] if self.wrist is None else self.wrist.set.tolist()
        return np.array([*self.p_end, self.roll_set, *turns, self.jaw_set])

    @property
    def target_in_force(self) -> Array:
        """The same of the newest sample of the stream that the arm obeys; else the set-point."""
        if self.p_BSample is None:
            return self.held_target
        p, wrist = self.p_go_on, self.wrist
        if wrist is None:
            return np.array([*p, self.roll_go_on, self.jaw_set])
        p = wrist.centre(p, wrist.q_RGoal, wrist.goal)
        return np.array([*p, self.roll_go_on, *wrist.goal, self.jaw_set])

    @cached_property
    def p_go_on(self) -> Array:
        """(3,) tip from which a sender goes on, see `contract.ARM_STATE`, in R [m]."""
        return self.p_set if self.p_BSample is None else self._in_rcm(self.p_BSample)

    @property
    def roll_go_on(self) -> float:
        """The roll of `p_go_on` [rad]."""
        return self.roll_set if self.p_BSample is None else self.roll_sample

    def _wristed_numbers(self, wrist: WristView) -> list[float]:
        follows = self.p_BSample is not None
        q, turns = (wrist.q_RGoal, wrist.goal) if follows else (wrist.q_RSet, wrist.set)
        centre = wrist.centre(self.p_go_on, q, turns)
        measured = virtual_joints(self._R_BR().T @ self.s_B, self.roll)
        measured[2] = self.depth
        return [
            *(*self.p_tip, *wrist.q_RTip, *measured, *wrist.measured, self.jaw),
            *(*self.p_go_on, *q, *virtual_joints(centre, self.roll_go_on), *turns),
        ]

    @cached_property
    def R_WR(self) -> Array:
        """(3, 3) orientation of the trocar frame in the world."""
        return np.asarray(self.R_WB @ self._R_BR())

    def _R_BR(self) -> Array:
        if self.R_BR is None:
            raise ValueError("ArmView: R_BR is unknown, so nothing can be said in the trocar frame")
        return self.R_BR

    def _in_rcm(self, p_B: Array) -> Array:
        return np.asarray(self._R_BR().T @ (p_B - self.p_BRcm))


@dataclass(frozen=True)
class TipPose:
    """Where tip and shaft shall be; the shaft passes through the trocar.

    Attributes:
        p: (3,) tip in R [m], not above the trocar.
        roll: Absolute roll about the shaft [rad].
        R_RTip: (3, 3) orientation of the tool frame behind a wrist; None: along the shaft.
    """

    p: Array
    roll: float
    R_RTip: Array | None = None

    @cached_property
    def q(self) -> Array:
        """(4,) orientation x, y, z, w; along the shaft minimal rotation (z to p) · Rz(roll)."""
        if self.R_RTip is not None:
            return matrix_to_quaternion_xyzw(self.R_RTip)
        return tip_quaternion(self.p, self.roll)

    @cached_property
    def joints(self) -> Array:
        """(4,) without a wrist the same as yaw, pitch [rad], insertion [m], roll [rad].

        The shaft is s = (sin yaw cos pitch, sin pitch, cos yaw cos pitch).
        """
        return virtual_joints(self.p, self.roll)


@dataclass
class ArmCommands:
    """Commands to one arm in answer to one cycle. Empty members are not sent.

    Attributes:
        stamp_ns: Stamp of the commands: the cycle they are meant for [ns].
        state: A state_command.
        claim: True: from now on no other node may move the arm.
        hold: True: stop.
        move_cp: Pose to move to.
        jaw: Jaw angle [rad].
        servo_cp: Pose of the stream.
        servo_jp: (4,) yaw, pitch [rad], insertion [m], roll [rad] of the stream, and behind a wrist
            (6,) its pitch and yaw [rad].
    """

    stamp_ns: int = 0
    state: str | None = None
    claim: bool = False
    hold: bool = False
    move_cp: TipPose | None = None
    jaw: float | None = None
    servo_cp: TipPose | None = None
    servo_jp: Array | None = None

    def __bool__(self) -> bool:
        """Whether there is anything to send."""
        values = (self.state, self.move_cp, self.jaw, self.servo_cp, self.servo_jp)
        return self.claim or self.hold or any(value is not None for value in values)


@dataclass(frozen=True)
class JawRange:
    """Range of an instrument's jaw [rad]; ``min`` is closed."""

    min: float
    max: float
