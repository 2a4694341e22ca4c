"""The console's figures, read out of messages as bytes."""

from __future__ import annotations

import io
import math

import numpy as np
from geometry_msgs.msg import WrenchStamped

from surg_console.ros.raw_gauges import cycle_gauges, force
from surg_console.ros.status_values_node import follower_of
from surg_msgs.msg import Cycle, HandStatus


def data(message: Cycle | WrenchStamped) -> bytes:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def test_they_are_what_the_messages_say() -> None:
    rng = np.random.default_rng(4)
    for _ in range(300):
        q, qd, reason, source = (int(n) for n in rng.integers(0, 8, 4))
        cycle = Cycle(q=rng.normal(size=q).tolist(), qd=rng.normal(size=qd).tolist())
        cycle.reason, cycle.source = "stopped"[:reason], "/teleop"[:source]
        lengths = rng.normal(size=4).tolist()
        cycle.depth, cycle.rcm_error, cycle.stop_bound_tip, cycle.stop_bound_pivot = lengths
        cycle.homed = q % 2 == 0
        cycle.p_goal, cycle.q_br = rng.normal(size=3).tolist(), rng.normal(size=4).tolist()
        wrench = WrenchStamped()
        f = wrench.wrench.force
        f.x, f.y, f.z = rng.normal(size=3).tolist()
        cycle.header.frame_id = wrench.header.frame_id = "PSM1_base"[: int(rng.integers(0, 10))]
        cycle.reason_code = int(rng.choice([Cycle.REASON_NONE, Cycle.REASON_LINK_LOST]))
        known = cycle.homed and cycle.reason_code == Cycle.REASON_NONE
        expected = cycle.depth if known else None
        assert cycle_gauges(data(cycle)) == (expected, *lengths[1:])
        assert force(data(wrench)) == math.hypot(f.x, f.y, f.z)
    wrench.wrench.force.z = 1e300
    assert force(data(wrench)) == 1e300, "one that cannot be is a number too"


def test_a_scale_is_a_number_or_none() -> None:
    assert [follower_of(HandStatus(scale=x)).scale for x in (0.2, 1)] == [0.2, 1.0]
    strange = (math.inf, -math.inf, math.nan)
    assert [follower_of(HandStatus(scale=x)).scale for x in strange] == [None] * 3


def test_what_is_no_such_message_says_nothing() -> None:
    rng = np.random.default_rng(5)
    whole = data(Cycle(homed=True, q=[0.1] * 6, depth=0.1234, stop_bound_pivot=5e-5))
    known = [cut for cut in range(len(whole)) if cycle_gauges(whole[:cut]).deviation is not None]
    assert min(known) == whole.index(np.array([0.1234, 0.0, 0.0, 5e-5]).tobytes()) + 32
    assert cycle_gauges(b"") == (None,) * 4 and force(b"") is None
    for _ in range(2000):
        junk = rng.integers(0, 256, int(rng.integers(0, 120)), dtype=np.uint8).tobytes()
        cycle_gauges(junk)
        force(junk)
