"""The operator's state machine against a fake arm on a fake clock."""

import os
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surg_core.arm_view import ArmCommands, ArmState, ArmView, JawRange, TipPose
from surg_core.bring_up import RETRY_NS, TIMEOUT_NS
from surg_core.contract import SECOND_NS, TICK_NS
from surg_teleop.playback.motion_file import Motion
from surg_teleop.playback.motion_plan import make_plan
from surg_teleop.playback.motion_player import (
    HOLD,
    JAW_EVERY,
    REST,
    RESTARTS,
    Mode,
    MotionPlayer,
    PlayerStage,
)
from surg_teleop.playback.workspace_fit import Workspace

WORKSPACE = Workspace(depth_min=0.030, depth_max=0.220, cone=1.0472)
JAW = JawRange(0.0, 0.7)
POSES = 20_000 if os.environ.get("SURG_TEST_FULL", "") not in ("", "0") else 1_000


@dataclass
class FakeArm:
    """An arm that obeys at once, a few cycles late, or never.

    It refuses the poses of a stream whose number, counted from 0, is in ``refuses``.
    """

    deaf_to: frozenset[str] = frozenset()
    move_cycles: int = 200
    tick: int = 0
    state: ArmState = ArmState.DISABLED
    homed: bool = False
    busy: int = 0
    p: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 0.12]))
    reason: str = ""
    refuses: range = range(0)
    streamed: int = 0
    refused: int = 0
    received: list[ArmCommands] = field(default_factory=list)
    accepted: list[np.ndarray] = field(default_factory=list)

    def feedback(self) -> ArmView:
        return ArmView(
            stamp_ns=self.tick * TICK_NS,
            state=self.state,
            homed=self.homed,
            busy=self.busy > 0,
            reason=self.reason,
            refused=self.refused,
            accepted=len(self.accepted),
            p_BSet=self.p,
            p_BTip=self.p,
            R_BR=np.eye(3),
        )

    def step(self, commands: ArmCommands) -> None:
        self.received.append(commands)
        self.tick += 1
        self.busy = max(self.busy - 1, 0)
        if commands.state and commands.state not in self.deaf_to:
            if commands.state == "home":
                self.homed = True
            if commands.state == "enable":
                self.state = ArmState.ENABLED
        if commands.move_cp is not None and "move_cp" not in self.deaf_to:
            self.busy, self.p = self.move_cycles, commands.move_cp.p
        if commands.servo_cp is not None:
            self._stream(commands.servo_cp.p)

    def _stream(self, p: np.ndarray) -> None:
        self.streamed += 1
        if self.streamed - 1 in self.refuses:
            self.refused += 1
            return
        self.p = p
        self.accepted.append(p)


def motion(seconds: float = 2.0) -> Motion:
    t = np.arange(int(seconds * 50) + 1) * 0.02
    p = np.column_stack((0.02 * np.sin(2 * t), 0.02 * np.sin(t), 0.01 * np.cos(t)))
    gripper = -0.4 + 0.5 * t
    return Motion("test.csv", t, p, 0.3 * t, gripper, np.arange(2, len(t) + 2))


def operator(mode: Mode = Mode.CARTESIAN, scale: float = 1.0) -> MotionPlayer:
    return MotionPlayer(make_plan(motion(), WORKSPACE, scale), mode, JAW)


def play(op: MotionPlayer, arm: FakeArm, ticks: int = 30_000) -> list[PlayerStage]:
    stages = [op.stage]
    for _ in range(ticks):
        arm.step(op.tick(arm.feedback()))
        if op.stage is not stages[-1]:
            stages.append(op.stage)
        if op.done:
            break
    return stages


@pytest.mark.parametrize("mode", list(Mode))
def test_a_whole_run(mode: Mode) -> None:
    op, arm = operator(mode), FakeArm()
    stages = play(op, arm)
    assert [
        s.value for s in stages if s is not PlayerStage.HOME and s is not PlayerStage.ENABLE
    ] == [
        "connect",
        "move",
        "settle",
        "play",
        "hold",
        "done",
    ]
    assert [c.state for c in arm.received if c.state] == ["home", "enable"]
    assert sum(c.move_cp is not None for c in arm.received) == 1
    streamed = [c for c in arm.received if c.servo_cp is not None or c.servo_jp is not None]
    wanted = op.plan.duration * 500 + HOLD / TICK_NS
    assert abs(len(streamed) - wanted) <= 2
    # Every cycle without a hole, stamped for the cycle it is meant for.
    stamps = np.array([c.stamp_ns for c in streamed])
    assert (np.diff(stamps) == TICK_NS).all()
    assert stamps[0] == op.started_ns
    assert all((c.servo_cp is None) == (mode is Mode.SPHERICAL) for c in streamed)
    assert [c.hold for c in arm.received].count(True) == 1
    assert arm.received[-1].hold
    assert op.reason == ""


def test_the_stream_follows_the_plan_exactly() -> None:
    op, arm = operator(), FakeArm()
    play(op, arm)
    for c in arm.received:
        if c.servo_cp is not None:
            t = (c.stamp_ns - op.started_ns) / SECOND_NS
            p, roll = op.plan.at(t)
            assert np.array_equal(c.servo_cp.p, p)
            assert np.array_equal(c.servo_cp.q, TipPose(p, roll).q)
    first, last = op.window_ns
    assert last - first == pytest.approx(op.plan.played * SECOND_NS, abs=2)


def test_both_modes_send_the_same_path() -> None:
    sent = {}
    for mode in Mode:
        op, arm = operator(mode), FakeArm()
        play(op, arm)
        sent[mode] = arm.received
    pairs = 0
    for a, b in zip(sent[Mode.CARTESIAN], sent[Mode.SPHERICAL], strict=True):
        if a.servo_cp is not None and b.servo_jp is not None:
            yaw, pitch, depth, _ = b.servo_jp
            s = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
            assert np.abs(depth * s - a.servo_cp.p).max() < 1e-15
            pairs += 1
    assert pairs > 1000


def test_time_is_the_stamps_difference_not_the_number_of_calls() -> None:
    """Cycles that get lost in free-run do not slow the motion down."""
    op, arm = operator(), FakeArm()
    rng = np.random.default_rng(5)
    while not op.done:
        commands = op.tick(arm.feedback())
        arm.step(commands)
        arm.tick += int(rng.integers(0, 3))
        if commands.servo_cp is not None:
            p, _ = op.plan.at((commands.stamp_ns - op.started_ns) / SECOND_NS)
            assert np.array_equal(commands.servo_cp.p, p)
    assert op.stage is PlayerStage.DONE


def test_jaw_is_the_opening_from_the_most_closed_clipped_to_the_range() -> None:
    op, arm = operator(), FakeArm()
    play(op, arm)
    jaws = [c.jaw for c in arm.received if c.jaw is not None]
    streamed = sum(c.servo_cp is not None for c in arm.received)
    assert len(jaws) == -(-streamed // JAW_EVERY)
    assert min(jaws) == pytest.approx(0.0, abs=1e-9)
    assert max(jaws) == JAW.max
    assert all(JAW.min <= jaw <= JAW.max for jaw in jaws)


def test_an_arm_that_is_already_up_is_not_homed_again() -> None:
    op, arm = operator(), FakeArm(state=ArmState.ENABLED, homed=True)
    play(op, arm)
    assert [c.state for c in arm.received if c.state] == []
    assert op.stage is PlayerStage.DONE


@pytest.mark.parametrize("deaf", ["home", "enable"])
def test_an_arm_that_does_not_get_ready_is_given_up(deaf: str) -> None:
    op, arm = operator(), FakeArm(deaf_to=frozenset({deaf}), reason="no trocar point")
    play(op, arm)
    assert op.stage is PlayerStage.FAILED
    assert f"'{deaf}'" in op.reason
    assert "no trocar point" in op.reason
    asked = TIMEOUT_NS // RETRY_NS
    assert sum(c.state == deaf for c in arm.received) in (asked, asked + 1)
    assert not any(c.servo_cp for c in arm.received)


def test_an_arm_that_does_not_arrive_is_given_up() -> None:
    op, arm = operator(), FakeArm(deaf_to=frozenset({"move_cp"}))
    play(op, arm)
    assert op.stage is PlayerStage.FAILED
    assert "did not reach the start" in op.reason
    assert "mm away" in op.reason


@pytest.mark.parametrize(
    "during",
    [PlayerStage.HOME, PlayerStage.MOVE, PlayerStage.SETTLE, PlayerStage.PLAY, PlayerStage.HOLD],
)
@pytest.mark.parametrize("state", [ArmState.FAULT, ArmState.PAUSED, ArmState.DISABLED])
def test_an_arm_that_stops_is_given_up_with_its_reason(
    during: PlayerStage, state: ArmState
) -> None:
    if state == ArmState.DISABLED and during is PlayerStage.HOME:
        pytest.skip("that is where it starts")
    op, arm = operator(), FakeArm(deaf_to=frozenset({"home"} if during is PlayerStage.HOME else ()))
    for _ in range(30_000):
        if op.stage is during:
            arm.state, arm.reason = state, "rcm_error"
        arm.step(op.tick(arm.feedback()))
        if op.done:
            break
    assert op.stage is PlayerStage.FAILED
    assert "rcm_error" in op.reason
    assert during.value in op.reason
    after = op.tick(arm.feedback())
    assert after == ArmCommands(stamp_ns=after.stamp_ns)  # nothing more, whatever happens


def test_refused_commands_are_counted_during_the_stream_only() -> None:
    op, arm = operator(), FakeArm()
    while not op.done:
        refused = 3 + (arm.tick > 900) * 4
        arm.step(op.tick(replace(arm.feedback(), refused=refused)))
    assert op.refused == 4


def assert_every_pose_was_accepted(op: MotionPlayer, arm: FakeArm) -> None:
    """On the path, without a hole, to its end."""
    assert op.stage is PlayerStage.DONE, op.reason
    steps = np.linalg.norm(np.diff(arm.accepted, axis=0), axis=1)
    fastest = 0.06  # [m/s] of motion()
    assert steps.max() <= fastest * TICK_NS / SECOND_NS
    assert np.array_equal(arm.accepted[-1], op.plan.at(op.plan.duration)[0])


def test_a_refused_pose_is_sent_again_until_it_is_accepted() -> None:
    op, arm = operator(), FakeArm(refuses=range(300, 390))
    stages = play(op, arm)
    assert stages.count(PlayerStage.MOVE) == 1
    assert_every_pose_was_accepted(op, arm)
    sent = [c.servo_cp.p for c in arm.received if c.servo_cp is not None]
    # The first answer to a refused pose comes a cycle later.
    assert all(np.array_equal(p, sent[301]) for p in sent[302:390])
    assert op.refused == 90
    assert op.slowed_ns == pytest.approx(90 * TICK_NS, abs=2 * TICK_NS)
    assert op.first_refusal is not None
    assert op.first_refusal[0] == pytest.approx(0.6, abs=0.005)


def test_a_stream_that_was_refused_for_longer_is_taken_up_from_rest() -> None:
    op, arm = operator(), FakeArm(refuses=range(300, 450))
    stages = play(op, arm)
    assert stages.count(PlayerStage.MOVE) == 2  # 0.2 s of refusals end the first stream
    assert_every_pose_was_accepted(op, arm)
    moves = [k for k, c in enumerate(arm.received) if c.move_cp is not None]
    for k in moves[1:]:  # any stream is over before the arm is asked to move
        silent = arm.received[k - REST // TICK_NS + 1 : k]
        assert all(c.servo_cp is None for c in silent)


def test_a_motion_that_is_refused_for_ever_fails_with_time_and_line() -> None:
    op, arm = operator(), FakeArm(refuses=range(300, 10**6), reason="outside_workspace")
    play(op, arm)
    assert op.stage is PlayerStage.FAILED
    assert sum(c.move_cp is not None for c in arm.received) == RESTARTS + 1
    assert op.first_refusal == (pytest.approx(0.6, abs=0.005), "outside_workspace")
    assert op.plan.place(op.clock) in op.reason


def test_tip_pose_is_minimal_rotation_times_roll() -> None:
    rng = np.random.default_rng(2)
    worst = 0.0
    for _ in range(POSES):
        p = rng.normal(0, 1, 3) * 0.1 + [0, 0, 0.1]
        if p[2] / np.linalg.norm(p) < -0.99:
            continue
        roll = rng.uniform(-9, 9)
        got = Rotation.from_quat(TipPose(p, roll).q).as_matrix()
        s = p / np.linalg.norm(p)
        axis = np.cross([0, 0, 1], s)
        angle = np.arctan2(np.linalg.norm(axis), s[2])
        swing = Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle)
        expected = (swing * Rotation.from_rotvec([0, 0, roll])).as_matrix()
        worst = max(worst, float(np.abs(got - expected).max()))
        assert np.allclose(got[:, 2], s)
    print(f"{POSES} poses, worst {worst:.1e}")
    assert worst < 1e-12
