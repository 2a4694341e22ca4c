"""A wristed instrument in the simulator: its true tip against the hand's full pose."""

import itertools
import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

import surg_core
from helpers.results.results_page import ResultsPage
from helpers.sim.wrist_follow import ARM, Array, Followed, WristedArm
from surg_cli.host import paths
from surg_description.make_cell import make_cell

PAGE = ResultsPage("wrist.md")
FULL = os.environ.get("SURG_TEST_FULL") == "1"
DRAWN = 10 if FULL else 1
TIP, TURN = 3e-4, np.radians(1.0)  # [m], rms
PIVOT = 1e-4  # [m] largest


def cell(name: str) -> surg_core.Cell:
    return surg_core.load_cell(paths.ROOT / "cells" / name)


def cell_with_lag(folder: Path, robot: str, lag: float, rolls: bool = True) -> surg_core.Cell:
    """A cell whose instrument's drive lags by ``lag`` [s], and says so.

    ``rolls``: it turns the shaft, too.
    """
    described = paths.ROOT / "src" / "surg_description"
    text = (described / "instruments" / "wristed_grasper.yaml").read_text("utf-8")
    drawing = (described / "urdf" / "wristed_grasper.urdf").read_text("utf-8")
    if not rolls:
        text = re.sub(r"\n  roll: .*", "", text)
        drawing = drawing.replace('"wrist_roll" type="revolute"', '"wrist_roll" type="fixed"')
    (folder / "tool.urdf").write_text(drawing, "utf-8")
    text = text.replace("../urdf/wristed_grasper.urdf", "tool.urdf")
    instrument = folder / "instrument.yaml"
    instrument.write_text(text.replace("lag: 0.04 ", f"lag: {lag} "), "utf-8")
    return surg_core.load_cell(
        make_cell(described / "robots" / f"{robot}.yaml", folder / "cell", instrument).parent
    )


def drawn(seed: int) -> Callable[[float], Array]:
    """A hand that moves by up to 12 mm and turns by up to 30 degrees about every axis."""
    draws = np.random.default_rng(seed)
    frequency, phase = draws.uniform(0.2, 0.7, 6), draws.uniform(0.0, 2 * np.pi, 6)
    size = np.concatenate([draws.uniform(0.005, 0.012, 3), draws.uniform(0.2, 0.5, 3)])

    def hand(t: float) -> Array:
        grow = 0.5 - 0.5 * np.cos(np.pi * min(t, 1.0))
        x = grow * size * (np.sin(2 * np.pi * frequency * t + phase) - np.sin(phase))
        return surg_core.make_pose(x[:3], x[3:])

    return hand


def recorded(file: Path, scale: float) -> tuple[Callable[[float], Array], float]:
    """A recorded hand, its turns about their middle, and how long it lasts [s]."""
    table = np.genfromtxt(file, delimiter=",", names=True)
    t = table["t_s"] - table["t_s"][0]
    p = np.stack([table[name] for name in ("x_m", "y_m", "z_m")], axis=1)
    rotations = Rotation.from_matrix(
        np.stack([table[f"r{i}{k}"] for i in "123" for k in "123"], axis=1).reshape(-1, 3, 3)
    )
    turned = rotations * rotations.mean().inv()
    place, turn = CubicSpline(t, scale * (p - p[0])), Slerp(t, turned)

    def hand(now: float) -> Array:
        begin = min(now, 1.0)  # the first second turns from the arm's own orientation
        to = turn(min(max(now - 1.0, 0.0), t[-1]))
        R = Rotation.from_rotvec((3 - 2 * begin) * begin**2 * to.as_rotvec()).as_matrix()
        return surg_core.make_pose(place(min(max(now - 1.0, 0.0), t[-1])), R)

    return hand, float(t[-1]) + 1.0


def note(row: str, runs: list[Followed]) -> tuple[Array, Array, float]:
    """Print and keep a row of the page; errors of all runs in one."""
    errors = [run.errors() for run in runs]
    far, turned = (np.concatenate([error[k] for error in errors]) for k in (0, 1))
    pivot = max(float(run.deviation.max()) for run in runs)
    rms = [np.sqrt(np.mean(values**2)) for values in (far, turned)]
    PAGE.note(
        row,
        None,
        f"{1e3 * rms[0]:.3f}/{1e3 * far.max():.2f} | {np.degrees(rms[1]):.2f}/"
        f"{np.degrees(turned.max()):.2f} | {1e3 * pivot:.3f}",
    )
    return far, turned, pivot


@pytest.mark.parametrize("robot", ["ur5e", "panda"])
def test_the_true_tip_follows_the_full_pose_of_a_hand(robot: str) -> None:
    held = cell(f"sim_{robot}_wrist")
    runs = [WristedArm(held).follow(drawn(seed), 5.0) for seed in range(DRAWN)]
    far, turned, pivot = note(f"drawn, {robot}, 40 ms", runs)
    assert sum(run.refused for run in runs) == 0
    assert np.sqrt(np.mean(far**2)) < TIP
    assert np.sqrt(np.mean(turned**2)) < TURN
    assert pivot < PIVOT


def test_a_straight_instrument_cannot_follow_the_orientation() -> None:
    runs = [WristedArm(cell("sim_ur5e")).follow(drawn(seed), 5.0) for seed in range(DRAWN)]
    _, turned, _ = note("drawn, ur5e, straight instrument", runs)
    assert np.degrees(turned.max()) > 5.0


@pytest.mark.parametrize(
    ("robot", "lag", "rolls"),
    [
        *itertools.product(["ur5e", "panda"], [0.02, 0.04, 0.06], [True]),
        ("ur5e", 0.04, False),
    ],
)
def test_a_recorded_surgeon_is_followed(
    robot: str, lag: float, rolls: bool, tmp_path: Path
) -> None:
    file = os.environ.get("SURG_TEST_MOTION")
    if not file:  # the bundled motion has no orientation
        return
    run = WristedArm(cell_with_lag(tmp_path, robot, lag, rolls)).follow(*recorded(Path(file), 0.3))
    motors = "" if rolls else ", the arm rolls"
    far, turned, pivot = note(f"{Path(file).stem}, {robot}, {1e3 * lag:.0f} ms{motors}", [run])
    assert run.refused == 0
    assert pivot < PIVOT
    # Its roll asks for up to 3.8 rad/s and 117 rad/s^2, which no arm's last joint gives.
    assert bool(np.sqrt(np.mean(far**2)) < TIP) is rolls
    assert bool(np.sqrt(np.mean(turned**2)) < TURN) is rolls


def test_a_recorded_surgeon_with_a_straight_instrument() -> None:
    if file := os.environ.get("SURG_TEST_MOTION"):
        run = WristedArm(cell("sim_ur5e")).follow(*recorded(Path(file), 0.3))
        _, turned, pivot = note(f"{Path(file).stem}, ur5e, straight instrument", [run])
        assert pivot < PIVOT
        assert np.sqrt(np.mean(turned**2)) > np.radians(5.0)


def test_what_the_controller_reports_is_where_the_tip_is() -> None:
    arm = WristedArm(cell("sim_ur5e_wrist"))
    arm.follow(drawn(4), 2.0)
    out = arm.step()
    assert out.wrist is not None
    X_RB = np.linalg.inv(arm.controller.X_BR)
    reported = X_RB[:3, :3] @ out.p_BTip + X_RB[:3, 3]
    assert np.linalg.norm(reported - arm.tip()[:3, 3]) < 1e-4  # one tick of motion
    assert np.abs(out.wrist.R_RTip - arm.tip()[:3, :3]).max() < 5e-3


def test_the_wrist_closed_form_is_there_for_python() -> None:
    wrist = cell("sim_ur5e_wrist").arms[ARM].instrument.wrist
    assert wrist is not None
    X_RCentre = surg_core.make_pose([0.0, 0.0, 0.1])
    X_RTip = surg_core.tip_of_wrist(wrist.geometry, X_RCentre, [0.4, -0.7])
    (centre, joints), (_, second) = surg_core.wrists_of_tip(wrist.geometry, X_RTip)
    assert centre == pytest.approx(X_RCentre, abs=1e-12)
    assert joints == pytest.approx([0.4, -0.7], abs=1e-12)
    assert abs(second[0]) > np.pi / 2
