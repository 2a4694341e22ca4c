"""The console's figures, as messages have them."""

from __future__ import annotations

import math

import pytest
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped

from surg_console.ros.status_values_node import follower_of, force_of, lengths_of
from surg_console.session.system_state import Gauges
from surg_msgs.msg import Cycle, HandStatus


@pytest.mark.parametrize(
    ("homed", "reason", "depth", "known"),
    [
        (True, Cycle.REASON_NONE, 0.1234, True),
        (False, Cycle.REASON_NONE, 0.1234, False),
        (True, Cycle.REASON_LINK_LOST, 0.1234, False),
        (True, Cycle.REASON_NONE, math.nan, False),
    ],
)
def test_a_depth_is_known_of_a_homed_arm_whose_joints_are(
    homed: bool, reason: int, depth: float, known: bool
) -> None:
    cycle = Cycle(homed=homed, reason_code=reason, depth=depth, rcm_error=2e-4)
    cycle.stop_bound_tip, cycle.stop_bound_pivot = 3e-3, 5e-5
    expected = depth if known else None
    assert lengths_of(cycle) == Gauges(rcm=2e-4, depth=expected, stop_tip=3e-3, stop_pivot=5e-5)


def test_a_force_is_its_magnitude() -> None:
    assert force_of(WrenchStamped(wrench=Wrench(force=Vector3(3.0, 0.0, -4.0)))) == 5.0
    assert force_of(None) is None


def test_a_scale_is_a_number_or_none() -> None:
    assert [follower_of(HandStatus(scale=x)).scale for x in (0.2, 1)] == [0.2, 1.0]
    strange = (math.inf, -math.inf, math.nan)
    assert [follower_of(HandStatus(scale=x)).scale for x in strange] == [None] * 3
