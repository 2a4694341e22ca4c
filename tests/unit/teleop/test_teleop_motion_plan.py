"""Where a motion is put, whether it fits, and the time line round it."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from surg_cli.host import paths
from surg_teleop.playback.motion_file import Motion, MotionError, read_motion
from surg_teleop.playback.motion_path import MotionPlan
from surg_teleop.playback.motion_plan import CENTRE_DEPTH, ConstantMotionError, make_plan
from surg_teleop.playback.workspace_fit import Workspace, box_centre, largest_scale

BUNDLED = paths.ROOT / "src/surg_teleop/motions/bundled.csv"
WORKSPACE = Workspace(depth_min=0.030, depth_max=0.220, cone=1.0472)
FAMILIES = 5_000 if os.environ.get("SURG_TEST_FULL", "") not in ("", "0") else 300


def moving(p: np.ndarray, t: np.ndarray | None = None, gripper: np.ndarray | None = None) -> Motion:
    times = np.arange(len(p)) * 0.02 if t is None else t
    return Motion(
        file="test.csv",
        t=times,
        p=p,
        roll=np.zeros(len(p)),
        gripper=gripper,
        lines=np.arange(2, len(p) + 2),
    )


def lissajous(n: int = 400, v0: float = 1.0) -> Motion:
    t = np.arange(n) * 0.02
    p = np.column_stack((0.03 * np.sin(v0 * t), 0.02 * np.sin(1.3 * t), 0.02 * np.cos(0.7 * t)))
    return moving(p, t, gripper=np.sin(t))


def inside(p: np.ndarray, workspace: Workspace) -> np.ndarray:
    depth = np.linalg.norm(p, axis=-1)
    angle = np.arccos(np.clip(p[..., 2] / depth, -1.0, 1.0))
    return (
        (depth >= workspace.depth_min) & (depth <= workspace.depth_max) & (angle <= workspace.cone)
    )


def test_largest_scale_is_the_largest() -> None:
    """Closed form against a fine scan: everything below fits, just above does not."""
    rng = np.random.default_rng(11)
    walls = set()
    for _ in range(FAMILIES):
        workspace = Workspace(
            rng.uniform(0.02, 0.05), rng.uniform(0.15, 0.3), rng.uniform(0.3, 1.3)
        )
        offsets = rng.normal(0, 0.03, (rng.integers(1, 12), 3)) * rng.uniform(0.2, 2, 3)
        first = largest_scale(offsets, CENTRE_DEPTH, workspace)
        walls.add(first.wall)
        centre = np.array([0, 0, CENTRE_DEPTH])
        below = centre + np.linspace(1e-6, 1 - 1e-9, 400)[:, None, None] * first.scale * offsets
        assert inside(below, workspace).all()
        above = centre + first.scale * (1 + 1e-6) * offsets
        assert not inside(above, workspace).all()
        assert not inside(above[first.index], workspace)
    print(f"{FAMILIES} random paths, walls met: {sorted(walls)}")
    assert walls == {"depth_min", "depth_max", "cone"}


def test_a_point_has_no_largest_scale() -> None:
    assert largest_scale(np.zeros((3, 3)), CENTRE_DEPTH, WORKSPACE).scale == np.inf


@pytest.mark.parametrize("scale", [0.2, 1.0, 1.7])
def test_the_box_is_centred_at_120_mm_and_scaled_only_by_scale(scale: float) -> None:
    motion = read_motion(BUNDLED)
    plan = make_plan(motion, WORKSPACE, scale)
    start, _ = plan.window
    p, roll = plan.path(start + motion.t)
    assert box_centre(p) == pytest.approx([0, 0, CENTRE_DEPTH], abs=1e-9)
    assert np.ptp(p, axis=0) == pytest.approx(scale * np.ptp(motion.p, axis=0), abs=1e-9)
    shape = p - p[0] - scale * (motion.p - motion.p[0])
    assert np.abs(shape).max() < 1e-12
    assert np.abs(roll - motion.roll).max() < 1e-12


def test_a_path_that_does_not_fit_is_refused_with_the_largest_scale_that_does() -> None:
    motion = read_motion(BUNDLED)
    with pytest.raises(MotionError) as caught:
        make_plan(motion, WORKSPACE, 4.0)
    message = str(caught.value)
    for words in (str(BUNDLED), "line ", "mm deep", "degrees", "allowed: 30 to 220 mm"):
        assert words in message
    fits = float(re.search(r"largest scale that fits is ([\d.]+)", message).group(1))  # type: ignore[union-attr]
    print(message)
    make_plan(motion, WORKSPACE, fits)
    with pytest.raises(MotionError):
        make_plan(motion, WORKSPACE, fits + 0.002)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"scale": 0.0}, "--scale: 0.0; allowed: 0.01 to 10.0"),
        ({"scale": float("nan")}, "--scale: nan"),
        ({"scale": -1.0}, "--scale"),
        ({"duration": 0.5}, "--duration: 0.5 s; allowed: 1 to 86400 s"),
        ({"duration": float("nan")}, "--duration: nan"),
    ],
)
def test_arguments_out_of_range_are_refused(arguments: dict[str, float], words: str) -> None:
    with pytest.raises(MotionError, match=re.escape(words)):
        make_plan(lissajous(), WORKSPACE, **arguments)


def test_a_duration_before_the_motion_begins_names_the_shortest_that_moves() -> None:
    """The bundled motion rests in its first second."""
    motion = read_motion(BUNDLED)
    with pytest.raises(ConstantMotionError, match=r"--duration 1: .*allowed: (\S+) to") as caught:
        make_plan(motion, WORKSPACE, duration=1.0)
    found = re.search(r"allowed: (\S+) to", str(caught.value))
    assert found is not None
    shortest = float(found.group(1))
    make_plan(motion, WORKSPACE, duration=shortest)
    with pytest.raises(ConstantMotionError):
        make_plan(motion, WORKSPACE, duration=shortest - 0.1)


def test_a_constant_motion_is_refused() -> None:
    still = moving(np.random.default_rng(0).normal(0, 1e-5, (200, 3)))
    with pytest.raises(ConstantMotionError, match=r"constant.*at least 1 mm"):
        make_plan(still, WORKSPACE)
    with pytest.raises(ConstantMotionError):
        make_plan(lissajous(), WORKSPACE, scale=0.01)


def derivatives(plan: MotionPlan, t: np.ndarray, h: float = 1e-5) -> tuple[np.ndarray, np.ndarray]:
    before, at, after = (plan.path(t + d)[0] for d in (-h, 0.0, h))
    return (after - before) / (2 * h), (after - 2 * at + before) / h**2


@pytest.mark.parametrize("duration", [None, 3.0, 30.0])
@pytest.mark.parametrize("v0", [0.0, 1.0, 4.0])
def test_time_line_is_smooth_and_rests_at_both_ends(duration: float | None, v0: float) -> None:
    plan = make_plan(lissajous(v0=v0), WORKSPACE, 1.0, duration)
    p, roll = plan.path(np.array([-1.0, 0.0, plan.duration, plan.duration + 5.0]))
    assert np.array_equal(p[0], p[1])
    assert np.allclose(p[2], p[3], atol=1e-15)
    assert np.isfinite(roll).all()
    t = np.arange(0.0, plan.duration, 0.002)
    fine, _ = plan.path(t)
    v = np.diff(fine, axis=0) / 0.002
    a = np.diff(v, axis=0) / 0.002
    assert np.linalg.norm(v[0]) < 1e-4
    assert np.linalg.norm(v[-1]) < 1e-4
    # No step anywhere: neither in the position nor in the velocity.
    assert np.linalg.norm(v, axis=1).max() < 0.35
    assert np.abs(a).max() < 2.5
    for joint in plan.window:
        velocity, _ = derivatives(plan, np.array([joint - 2e-4, joint + 2e-4]))
        assert np.linalg.norm(velocity[0] - velocity[1]) < 2e-3


def test_the_recorded_motion_is_never_altered() -> None:
    motion = lissajous(v0=3.0)  # moves at 90 mm/s in its first sample
    plan = make_plan(motion, WORKSPACE)
    start, end = plan.window
    assert end - start == pytest.approx(motion.duration)
    assert plan.run_in >= 0.15
    p, _ = plan.path(start + motion.t[:-1])
    assert np.abs(np.diff(p, axis=0) - np.diff(motion.p[:-1], axis=0)).max() < 1e-12


@pytest.mark.parametrize("duration", [None, 3.0, 30.0])
def test_one_time_and_many_times_are_the_same_path(duration: float | None) -> None:
    plan = make_plan(lissajous(v0=2.0), WORKSPACE, 1.0, duration)
    t = np.concatenate((np.linspace(-1, plan.duration + 1, 2_000), plan.run_in + plan.motion.t))
    p, roll = plan.path(t)
    for i, time in enumerate(t):
        one, turn = plan.at(float(time))
        assert np.abs(one - p[i]).max() < 1e-12
        assert abs(turn - roll[i]) < 1e-12


def test_a_longer_duration_repeats_the_motion() -> None:
    motion = lissajous()
    plan = make_plan(motion, WORKSPACE, 1.0, 40.0)
    period = motion.duration + plan.back
    t = plan.run_in + np.linspace(0.0, motion.duration, 300)
    once, _ = plan.path(t)
    for n in (1, 2):
        again, _ = plan.path(t + n * period)
        assert np.abs(again - once).max() < 1e-9
    assert plan.played == 40.0
    assert plan.opening(plan.run_in + 1.0) == pytest.approx(
        plan.opening(plan.run_in + 1.0 + period)
    )


def test_a_shorter_duration_centres_what_is_played() -> None:
    plan = make_plan(lissajous(), WORKSPACE, 1.0, 2.0)
    assert plan.played == pytest.approx(2.0)
    start, _ = plan.window
    p, _ = plan.path(start + plan.motion.t)
    assert box_centre(p) == pytest.approx([0, 0, CENTRE_DEPTH], abs=1e-6)


def test_gripper_is_relative_to_its_most_closed() -> None:
    plan = make_plan(lissajous(), WORKSPACE)
    openings = [plan.opening(t) for t in np.linspace(0, plan.duration, 500)]
    assert min(o for o in openings if o is not None) == pytest.approx(0.0, abs=1e-3)
    assert max(o for o in openings if o is not None) == pytest.approx(2.0, abs=1e-3)
    still = make_plan(moving(lissajous().p), WORKSPACE)
    assert still.opening(1.0) is None


def test_a_run_in_that_does_not_fit_says_so(tmp_path: Path) -> None:
    """The first sample races along the wall: the way in would start behind it."""
    t = np.arange(100) * 0.02
    p = np.column_stack((0.0 * t, 0.0 * t, 0.045 - 0.045 * t))
    workspace = Workspace(0.030, 0.166, 1.0)
    with pytest.raises(MotionError, match="on the way in"):
        make_plan(moving(p, t), workspace)
