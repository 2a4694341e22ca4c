"""lerobot 0.6.1 and an arm of a running system, by its commands: recorded, and led by a policy.

Opt-in: `./surg test --tier oracle`. Needs Python 3.13; its environment, made at first use, is big.
"""

from __future__ import annotations

import re
import subprocess
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from helpers.graph.ros import RosGraph
from helpers.lerobot.lerobot_today import LeRobot, options
from helpers.policy.policy_rig import PolicyRig

pytestmark = [pytest.mark.ros, pytest.mark.oracle]

PATIENCE_S = 240.0
"""A busy machine imports torch for a long time."""


@pytest.fixture(scope="module")
def lerobot(tmp_path_factory: pytest.TempPathFactory) -> LeRobot:
    return LeRobot(tmp_path_factory.mktemp("lerobot"))


def ended(lerobot: LeRobot, rig: PolicyRig, program: subprocess.Popen[str]) -> str:
    """Enable the policy until the arm moves; returns what lerobot said at its end."""
    asked = 0.0

    def moves() -> bool:
        nonlocal asked
        if rig.state in ("READY", "PAUSED") and time.monotonic() - asked > 1.0:
            asked = time.monotonic()
            rig.enable.publish(True)
        return bool(rig.actions) or program.poll() is not None

    try:
        rig.graph.wait_for(moves, PATIENCE_S, f"lerobot to move the arm ({rig.status})")
    finally:
        said = lerobot.end(program, PATIENCE_S)
    assert not rig.rejected, rig.rejected[0]
    return said


def way(rig: PolicyRig) -> float:
    """From the set-point of the first relayed step to where the arm rests [m]."""
    first, last = rig.actions[0].values, rig.actions[-1].values
    return float(np.linalg.norm(np.subtract(last[:3], first[:3])))


def test_lerobot_records_an_arm_that_a_hand_leads(
    lerobot: LeRobot, ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    """Half a deflection for four seconds; what is recorded is what the arm was told and did."""
    rig = PolicyRig(ros_graph)
    arm = options(robot__type="surg_arm", robot__server=rig.address)
    hand = options(
        teleop__type="surg_hand",
        teleop__server=rig.address,
        teleop__discover_packages_path="made_up_lerobot",
        teleop__device="tilted",
    )
    data = options(
        dataset__repo_id="local/made_up",
        dataset__root=tmp_path / "set",
        dataset__no_stamp="true",
        dataset__single_task="move along x",
        dataset__fps=20,
        dataset__num_episodes=1,
        dataset__episode_time_s=4,
        dataset__push_to_hub="false",
        play_sounds="false",
    )
    ended(lerobot, rig, lerobot.start("lerobot-record", *arm, *hand, *data))
    (path,) = (tmp_path / "set" / "data").rglob("*.parquet")
    rows = pq.read_table(path)
    state, action = (np.stack(rows[key].to_numpy()) for key in ("observation.state", "action"))
    relayed = np.array([message.values for message in rig.actions])
    print(f"{len(rows)} rows, {len(relayed)} relayed steps, {way(rig) * 1e3:.1f} mm")
    assert 60 <= len(rows) <= 81
    # Every action that the arm carried out was recorded, and lies half a deflection further on.
    told = [np.abs(action - np.float32(row)).max(axis=1).min() for row in relayed]
    assert max(told) < 1e-6
    np.testing.assert_allclose(action[:, 0] - state[:, 5], 0.0005, atol=1e-6)
    # The measured tip, column 0, has gone that way, and so has the controller's in its own frame.
    mine = [seen.p_tip for seen in rig.cycles if seen.source == "/policy"]
    led = np.linalg.norm(mine[-1] - mine[0])
    assert 0.01 < way(rig) < 0.045
    assert led == pytest.approx(way(rig), abs=0.003)
    assert state[-1, 0] - state[0, 0] == pytest.approx(way(rig), abs=0.005)
    rig.close()


def test_lerobots_real_time_chunking_leads_the_arm(
    lerobot: LeRobot, ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    """A policy that is slower than a period; 12 mm along x without a refused step."""
    lerobot.run("python", "-m", "made_up_lerobot.modeling_sweep", tmp_path / "sweep")
    rig = PolicyRig(ros_graph)
    words = options(
        robot__discover_packages_path="made_up_lerobot",
        policy__path=tmp_path / "sweep",
        robot__type="surg_arm",
        robot__server=rig.address,
        inference__type="rtc",
        inference__queue_threshold=20,
        task="move along x",
        fps=20,
        duration=6,
        return_to_initial_position="false",
        play_sounds="false",
    )
    said = ended(lerobot, rig, lerobot.start("lerobot-rollout", *words))
    assert "RTC inference thread started" in said and not re.search("inference error", said)
    steps = np.diff([message.values[0] for message in rig.actions])
    print(f"{len(steps)} steps, {way(rig) * 1e3:.2f} mm, largest {steps.max() * 1e3:.2f} mm")
    assert way(rig) == pytest.approx(0.012, abs=0.0021)  # the first rows were late, and left out
    assert (steps > -1e-6).all() and steps.max() < 0.0021
    rig.close()
