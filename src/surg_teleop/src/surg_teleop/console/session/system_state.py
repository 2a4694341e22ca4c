"""What the console knows of the running system: plain values, filled by the node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Arm:
    """One arm, as it speaks of itself.

    Attributes:
        name: CRTK name.
        state: DISABLED, ENABLED, PAUSED, FAULT; empty: it has not spoken.
        homed: Whether it is homed.
        heard: When it last spoke, on the steady clock [s].
        because: What it said when it came into this state, in words.
        warning: Its newest warning, in words.
        warned: When that came [s].
    """

    name: str
    state: str = ""
    homed: bool = False
    heard: float = -1e9
    because: str = ""
    warning: str = ""
    warned: float = -1e9

    def ready(self) -> bool:
        """Whether it may be driven."""
        return self.state == "ENABLED" and self.homed


@dataclass(frozen=True)
class Follower:
    """What the teleoperation node says of one hand on one arm.

    Attributes:
        state: DISABLED, WAITING, FOLLOWING, CLUTCHED, FAULT; empty: it does not speak.
        mapping: "position" or "rate".
        reason: Why the tip does not follow, or what holds it, in words.
        scale: Of motion.
        leader: The hand.
        arm: The arm.
    """

    state: str = ""
    mapping: str = "position"
    reason: str = ""
    scale: float | None = None
    leader: str = ""
    arm: str = ""

    @property
    def following(self) -> bool:
        """Whether the tip follows the hand."""
        return self.state == "FOLLOWING"


@dataclass(frozen=True)
class Gauges:
    """Live figures of the driven arm; None: nobody says it.

    Attributes:
        rcm: Deviation from the trocar point [m].
        rcm_peak: Its largest value since the last report [m].
        depth: Of the tip behind the trocar [m].
        trocar: Force of the shaft on the trocar [N].
        tip: Force at the tip [N].
        age: How old the figures are [s].
    """

    rcm: float | None = None
    rcm_peak: float | None = None
    depth: float | None = None
    trocar: float | None = None
    tip: float | None = None
    age: float | None = None


@dataclass(frozen=True)
class Robot:
    """Everything at one moment.

    Attributes:
        arms: The driven arm first, then what must be ready beside it.
        follower: The operator's hand on the driven arm.
        scope: The same hand on the endoscope's arm, where one holds it.
        helpers: Other hands on other arms.
        gauges: Of the driven arm.
        record: The newest `/record/status`.
        sim: The newest `/sim/status`; empty on a real system.
        policy: The newest `/policy/status`; empty: no model server speaks.
    """

    arms: tuple[Arm, ...] = ()
    follower: Follower = Follower()
    scope: Follower = Follower()
    helpers: tuple[Follower, ...] = ()
    gauges: Gauges = Gauges()
    record: Mapping[str, Any] = field(default_factory=dict)
    sim: Mapping[str, Any] = field(default_factory=dict)
    policy: Mapping[str, Any] = field(default_factory=dict)

    @property
    def astray(self) -> tuple[str, ...]:
        """Simulated arms in FAULT: nobody stands beside them who could put them back."""
        return tuple(a.name for a in self.arms if self.sim and a.state == "FAULT")
