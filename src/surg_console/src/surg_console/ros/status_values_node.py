"""Status messages of other nodes as the values of the page."""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import WrenchStamped

import surg_core
from surg_console.session.fixture_view import region_of
from surg_console.session.page_status import finite
from surg_console.session.system_state import (
    Drift,
    Follower,
    Gauges,
    PolicyServer,
    Recorder,
    SimTask,
)
from surg_core import Fixture
from surg_core.status_check import LatestStatus, value_name
from surg_msgs.msg import (
    CalibrationStatus,
    Cycle,
    DriftStatus,
    HandStatus,
    PolicyStatus,
    RecordStatus,
    SimStatus,
)

REASONS = {int(reason): reason for reason in surg_core.Reason.__members__.values()}
_BLIND = (Cycle.REASON_LINK_LOST, Cycle.REASON_STATE_NOT_FINITE)


def lengths_of(cycle: Cycle) -> Gauges:
    """Lengths of the driven arm; its depth is unknown before homing, and while its joints are."""
    known = cycle.homed and cycle.reason_code not in _BLIND and math.isfinite(cycle.depth)
    return Gauges(
        rcm=cycle.rcm_error,
        depth=cycle.depth if known else None,
        stop_tip=cycle.stop_bound_tip,
        stop_pivot=cycle.stop_bound_pivot,
    )


def force_of(message: WrenchStamped | None) -> float | None:
    """Magnitude of the force [N]; None: unknown."""
    if message is None:
        return None
    f = message.wrench.force
    return math.hypot(f.x, f.y, f.z)


def fixture_of(message: Any) -> Fixture:
    """A fixture of a surg_msgs/Fixtures."""
    places = {
        name: (vector.x, vector.y, vector.z)
        for name in ("point", "normal", "end")
        for vector in [getattr(message, name)]
    }
    return region_of(
        message.name, message.shape, message.side, message.of, radius=message.radius, **places
    )


def follower_of(hand: HandStatus) -> Follower:
    """One leader on one arm."""
    state = value_name(hand, "state")
    return Follower(
        state=state,
        reason=hand.detail,
        scale=finite(hand.scale),
        leader=hand.leader,
        arm=hand.arm,
        at_wall=state == "FOLLOWING" and bool(hand.detail),
    )


def recorder_of(latest: LatestStatus, now: float) -> Recorder:
    """The recorder; one that has fallen silent may still be recording, and `problem` says so."""
    status: RecordStatus | None = latest.valid
    if status is None:
        return Recorder()
    problem = latest.problem(now) or status.detail
    return Recorder(value_name(status, "state"), problem, status.finished)


def task_of(status: SimStatus) -> SimTask:
    """The phantom's task."""
    task = status.task
    return SimTask(value_name(task, "state"), task.name, task.phase, task.detail, task.seed)


def calibration_of(status: CalibrationStatus) -> dict[str, Any]:
    """The collector of calibration views, by the names of its message."""
    said = {name: getattr(status, name) for name in status.__slots__[2:]}  # header, version
    names = {name: value_name(status, name) for name in ("state", "step")}
    return {**said, **names, "residual": finite(status.residual)}


def policy_of(status: PolicyStatus) -> PolicyServer:
    """The model server."""
    state = value_name(status, "state")
    return PolicyServer(state, status.policy, status.detail, status.refused)


def drift_of(status: DriftStatus) -> Drift:
    """The watch over the picture."""
    if status.state == DriftStatus.STATE_UNKNOWN:
        return Drift(status.detail, refusal=status.refusal)
    least, expected, most = map(finite, (status.least, status.expected, status.most))
    return Drift(status.detail, least, expected, most, status.refusal)
