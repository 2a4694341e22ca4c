"""The way of `check_frames`, without ROS: moves, waits for pictures, and stops on every way out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from helpers.control.gate_arm import SPEED, TICK, GateArm
from surg_core.arm_view import ArmCommands, ArmState, ArmView
from surg_teleop.frames.frame_check import STILL_S, FrameCheckStage, FramesCheck, Pair, split
from surg_teleop.frames.probe_moves import REST, SIDE, STEPS
from surg_teleop.frames.probe_moves import SPEED as SLOW
from surg_teleop.playback.workspace_fit import Workspace

Array = NDArray[np.float64]
WORKSPACE = Workspace(depth_min=0.030, depth_max=0.220, cone=1.0472)
R_WV = Rotation.from_euler("xyz", [2.4, 0.3, -1.1]).as_matrix()
BLANK = np.zeros((4, 6, 3), dtype=np.uint8)
NS = 1_000_000_000


@dataclass
class Bench:
    """A check, an arm that follows it, and a camera that remembers where the tip was."""

    arm: GateArm = field(default_factory=GateArm)
    check: FramesCheck = field(default_factory=lambda: FramesCheck("PSM1", "/teleop", WORKSPACE))
    R_WV: Array = field(default_factory=lambda: R_WV)
    live: bool = True
    late: float = 0.04
    pair: Pair | None = None
    tips: dict[int, Array] = field(default_factory=dict)
    log: list[ArmCommands] = field(default_factory=list)
    change: Callable[[ArmView], ArmView] = lambda view: view

    def tick(self) -> None:
        if self.live and self.arm.tick % 25 == 0:
            stamp = round((self.arm.tick * TICK - self.late) * NS)
            self.pair = Pair(stamp, BLANK, BLANK)
        view = self.change(self.arm.view())
        self.tips[view.stamp_ns] = np.array(self.arm.p)
        commands = self.check.tick(view, self.R_WV, self.pair)
        self.log.append(commands)
        self.arm.step(commands)

    def run(self, most: float = 60.0, until: Callable[[], bool] = lambda: False) -> Bench:
        for _ in range(round(most / TICK)):
            if self.check.done or until():
                break
            self.tick()
        return self


def test_it_goes_everywhere_and_comes_back() -> None:
    bench = Bench().run()
    assert bench.check.stage is FrameCheckStage.DONE, bench.check.reason
    assert bench.arm.refusals == []
    assert set(bench.check.pictures) == set(STEPS)
    home = bench.tips[min(bench.tips)]
    for step, pair in bench.check.pictures.items():
        tip = bench.tips[pair.stamp_ns]
        assert bench.arm.R_WR @ (tip - home) == pytest.approx(R_WV @ step.offset(), abs=1e-6)
    assert bench.arm.p == pytest.approx(home, abs=1e-6)
    assert bench.log[-1].hold
    assert not any(c.claim for c in bench.log), "a claim would outlive the check"
    tips = np.array(list(bench.tips.values()))
    fastest = float(np.linalg.norm(np.diff(tips, axis=0), axis=1).max()) / TICK
    print(f"{bench.arm.tick * TICK:.1f} s, tip at most {1e3 * fastest:.1f} mm/s")
    assert fastest < 1.05 * SLOW < SPEED / 10
    assert float(np.linalg.norm(tips - home, axis=1).max()) < SIDE + 1e-6


def test_a_picture_counts_only_when_the_tip_has_rested() -> None:
    bench = Bench(late=0.3).run()  # pictures that come 0.3 s after they were taken
    assert bench.check.stage is FrameCheckStage.DONE, bench.check.reason
    for pair in bench.check.pictures.values():
        k = pair.stamp_ns
        before = [bench.tips[s] for s in bench.tips if k - STILL_S * NS <= s <= k]
        assert float(np.ptp(before, axis=0).max()) < 1e-6


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: replace(v, state=ArmState.DISABLED), "is DISABLED; enable it first"),
        (lambda v: replace(v, state=ArmState.FAULT, reason="link"), "is FAULT (link)"),
        (lambda v: replace(v, homed=False), "is not homed"),
        (lambda v: replace(v, holder="/operator"), "is held by /operator"),
    ],
)
def test_it_refuses_politely_and_moves_nothing(
    change: Callable[[ArmView], ArmView], words: str
) -> None:
    bench = Bench(change=change).run(1.0)
    assert bench.check.stage is FrameCheckStage.FAILED
    assert words in bench.check.reason
    assert all(c.servo_cp is None and c.state is None and not c.claim for c in bench.log)


def test_it_refuses_where_there_is_no_room() -> None:
    bench = Bench(arm=GateArm(p=np.array([0.0, 0.0, 0.032]))).run(1.0)
    assert "no room to move up (depth_min" in bench.check.reason
    assert all(c.servo_cp is None for c in bench.log)


def test_it_enables_only_where_it_is_told_to() -> None:
    bench = Bench(arm=GateArm(state=ArmState.DISABLED, homed=False))
    bench.check.enable = True
    bench.run()
    assert bench.check.stage is FrameCheckStage.DONE, bench.check.reason
    assert [c.state for c in bench.log if c.state] == ["home", "enable"]


def pause(bench: Bench) -> None:
    bench.arm.leave(ArmState.PAUSED, "force")


def refuse(bench: Bench) -> None:
    bench.arm.refusals.append("step_too_large")


def scope_moves(bench: Bench) -> None:
    bench.R_WV = Rotation.from_rotvec([0.0, 0.02, 0.0]).as_matrix() @ R_WV


def camera_dies(bench: Bench) -> None:
    bench.live = False


def held_up(bench: Bench) -> None:
    bench.arm.stuck = True


def interrupted(bench: Bench) -> None:
    bench.arm.step(bench.check.stop("it was interrupted"))


@pytest.mark.parametrize(
    ("what", "words"),
    [
        (pause, "is PAUSED (force)"),
        (refuse, "refused a command"),
        (scope_moves, "the endoscope has moved"),
        (camera_dies, "no picture for 5 s"),
        (held_up, "check for an obstacle"),
        (interrupted, "interrupted"),
    ],
)
@pytest.mark.parametrize("seconds", [0.3, 1.2, 3.3])
def test_every_way_out_holds_the_arm(
    what: Callable[[Bench], None], words: str, seconds: float
) -> None:
    bench = Bench().run(seconds)
    assert not bench.check.done
    what(bench)
    bench.run()
    assert bench.check.stage is FrameCheckStage.FAILED
    assert words in bench.check.reason
    after = np.array(bench.arm.p)
    assert bench.arm.goal is None, "the stream has ended with a hold"
    for _ in range(200):
        bench.tick()
    assert np.array_equal(bench.arm.p, after)
    assert all(c.servo_cp is None for c in bench.log[-200:])


def test_pictures_of_one_or_two_eyes() -> None:
    both = {REST: Pair(1, BLANK, BLANK)}
    one = {REST: Pair(1, BLANK, None)}
    assert split(both)[1] == {REST: BLANK}
    assert split(one)[1] is None
