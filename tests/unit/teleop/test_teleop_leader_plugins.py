"""Leaders: bundled, from a file, and how a leader that fails is treated."""

import math
from pathlib import Path

import numpy as np
import pytest

from helpers.control.gate_arm import TICK
from helpers.teleop.hand import settings
from surg_cli.host import paths
from surg_teleop.follow.arm_switch import REOPEN, ArmSwitch
from surg_teleop.follow.arm_switch import Hand as SeatedHand
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.leaders import leader as leaders
from surg_teleop.leaders.bundled.crtk import CrtkLeader
from surg_teleop.leaders.bundled.motion import MotionLeader
from surg_teleop.leaders.leader import LeaderError

BUNDLED = paths.ROOT / "src/surg_teleop/motions/bundled.csv"


def test_bundled_leaders_are_found_and_an_unknown_one_names_them() -> None:
    assert {"motion", "crtk"} <= set(leaders.names())
    for name in leaders.names():
        assert hasattr(leaders.KIND.find(name), "read")
    with pytest.raises(LeaderError, match=r"glove: there is no such leader; there are crtk, "):
        leaders.load("glove", {})
    with pytest.raises(LeaderError, match=r"setting speed is unknown; allowed: name, rotation"):
        leaders.load("crtk", {"speed": 1.0})
    with pytest.raises(LeaderError, match=r"rate: 0.1; allowed: 1 to 1000 Hz"):
        leaders.load("motion", {"file": "x.csv", "rate": 0.1})


def test_a_leader_from_outside_the_tree_runs_by_path(tmp_path: Path) -> None:
    file = tmp_path / "my_leader.py"
    file.write_text(
        '''"""A leader that sits still."""
import numpy as np
from surg_core.hand.leader_sample import HandlePose, LeaderSample

class Still:
    def __init__(self, depth=0.1):
        self.name, self.depth = "still", depth
    def open(self):
        pass
    def read(self, now):
        return LeaderSample(now, HandlePose(np.array([0.0, 0.0, self.depth]), np.eye(4)[3]))
    def close(self):
        pass
'''
    )
    found = leaders.load(str(file), {"depth": 0.2})
    assert isinstance(found, leaders.Leader)
    sample = found.read(3.0)
    assert sample is not None
    assert sample.finite()
    assert sample.pose.p_VH[2] == 0.2
    file.write_text("x = 1\n")
    with pytest.raises(LeaderError, match="defines 0 leaders; one public class"):
        leaders.load(str(file), {})
    file.write_text("1 / 0\n")
    with pytest.raises(LeaderError, match="ZeroDivisionError"):
        leaders.load(str(file), {})


def test_a_motion_file_is_a_hand_that_rests_plays_and_rests() -> None:
    leader = MotionLeader(str(BUNDLED), rate=30.0, delay=1.0, rotation=(0.0, 0.0, math.pi / 2))
    assert leader.read(0.0) is None
    leader.open()
    samples = [leader.read(10.0 + k * TICK) for k in range(2000)]
    stamps = np.unique([s.stamp for s in samples])
    assert np.diff(stamps) == pytest.approx(1.0 / 30.0)
    assert all(s.stamp <= 10.0 + k * TICK + 1e-6 for k, s in enumerate(samples))
    assert np.array_equal(samples[0].pose.p_VH, samples[490].pose.p_VH)
    x, y, _ = samples[0].pose.p_VH
    raw = leader._spline(0.0)
    assert [y, -x] == pytest.approx(raw[:2])  # turned by 90 degrees
    assert not np.array_equal(samples[490].pose.p_VH, samples[1999].pose.p_VH)
    assert all(s.finite() and 0.0 <= s.grip <= 1.0 for s in samples)
    last = leader.read(10.0 + 3600.0)
    assert last.stamp == pytest.approx(3610.0, abs=0.04)
    leader.close()
    assert leader.read(3611.0) is None
    with pytest.raises(LeaderError, match=r"motion: .*cannot be read"):
        MotionLeader("/nowhere.csv").open()


class Faulty(CrtkLeader):
    """Somebody's own, with a mistake in it."""

    def __init__(self) -> None:
        self.name, self.opened = "faulty", 0

    def open(self) -> None:
        self.opened += 1

    def read(self, now: float) -> None:
        raise ZeroDivisionError("division by zero")

    def close(self) -> None:
        raise AttributeError("device")


def test_a_leader_that_raises_whatever_it_likes_is_a_leader_that_is_lost() -> None:
    """So the arm is held and paused, and the node ends as it should."""
    leader = Faulty()
    hand = SeatedHand(leader, ArmSwitch(Teleop(settings())))
    for now in (0.0, 0.5 * REOPEN, 1.1 * REOPEN):
        assert hand.read(now) is None
        assert hand.problem == "ZeroDivisionError: division by zero"
    assert leader.opened == 2


def test_a_crtk_leader_is_what_its_topics_say() -> None:
    leader = CrtkLeader("MTMR", rotation=(math.pi, 0.0, 0.0), grip_closed=-0.1, grip_open=0.9)
    leader.open()
    one = np.array([0.0, 0.0, 0.0, 1.0])
    assert leader.read(0.0) is None
    leader.on_pose(1.0, np.array([0.1, 0.2, 0.3]), one)
    leader.on_grip(1.0, 0.4)
    sample = leader.read(5.0)
    assert sample.stamp == 1.0  # an old pose stays old
    assert sample.pose.p_VH == pytest.approx([0.1, -0.2, -0.3])
    assert sample.grip == pytest.approx(0.5)
    leader.on_pose(7.0, np.zeros(3), np.array([0.0, 0.0, 0.0, 0.5]))
    assert not leader.read(7.0).finite()
    leader.on_rate(8.0, np.array([0.0, 0.01, 0.0]), np.array([0.0, 0.0, 0.2]))
    sample = leader.read(8.0)
    assert sample.pose is None  # a second old
    assert sample.rate.v_V == pytest.approx([0.0, -0.01, 0.0])
    assert sample.rate.roll == pytest.approx(-0.2)
    leader.on_state("PAUSED")
    assert leader.read(8.0).problem == "is PAUSED: enable it, then press the clutch or enable"
