"""Mass, centre, bias and frame from postures: inside their own intervals, refused in contact."""

import dataclasses
import datetime
import hashlib
from pathlib import Path

import numpy as np
import pytest

from helpers.force.statics import Array, Situation, drawn, rotation, turn
from surg_core import CalibrationError, ConfigError
from surg_core.force import load_solver
from surg_core.force.compensation import ToolLoad
from surg_core.force.force_file import ForceCalibration, check_current, load_force, write_force
from surg_core.force.load_solver import Posture, solve_load, zero
from surg_core.force.sensor_file import ForceSensor

NOISE = np.array([0.05, 0.05, 0.05, 0.001, 0.001, 0.001])
DRIFT = np.array([0.05, 0.05, 0.05, 0.002, 0.002, 0.002])
READINGS = 250


def case_of(rng: np.random.Generator) -> tuple[Situation, ForceSensor]:
    """A free tool on a sensor that is mounted up to half a degree off its drawing."""
    case = dataclasses.replace(drawn(rng), tip=np.zeros(3), trocar=np.zeros(3))
    X_FS = np.eye(4)
    X_FS[:3, :3], X_FS[:3, 3] = case.R_FS @ turn(0.005 * rng.normal(size=3)), case.p_FS
    sensor = ForceSensor(
        "test", 500.0, np.array([200.0] * 3 + [20.0] * 3), NOISE, DRIFT, 1.0, False, X_FS,
        np.zeros(6), np.zeros(3),
    )  # fmt: skip
    return case, sensor


def postures(
    case: Situation, rng: np.random.Generator, n: int = 12, push: Array | None = None
) -> list[Posture]:
    """The case's tool in drawn orientations; push (3,) presses on the tip in the first one."""
    found = []
    for k in range(n):
        X = np.eye(4)
        X[:3, :3] = rotation(rng)
        tip = push if push is not None and k == 0 else np.zeros(3)
        reading = dataclasses.replace(case, X_BF=X, tip=tip).reading()
        reading = reading + NOISE / np.sqrt(READINGS) * rng.normal(size=6)
        wrong = turn(load_solver.POSTURE_SD * rng.normal(size=3))
        found.append(Posture(wrong @ X[:3, :3].T @ case.g, reading, READINGS))
    return found


def errors(case: Situation, load: ToolLoad) -> Array:
    """True minus found, (13,), as the covariance means them."""
    R = load.R_FS.T @ case.R_FS
    phi = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    away = [[case.mass - load.mass], case.p_SCom - load.p_SCom, case.bias - load.bias, phi]
    return np.concatenate(away)


def test_each_parameter_is_inside_its_own_interval_in_at_least_90_of_100_cases() -> None:
    rng = np.random.default_rng(1)
    inside = np.zeros(13)
    jointly, worst = 0, np.zeros(13)
    for _ in range(100):
        case, sensor = case_of(rng)
        fit = solve_load(postures(case, rng), sensor)
        e = errors(case, fit.load)
        inside += np.abs(e) <= 1.96 * np.sqrt(np.diag(fit.load.covariance))
        jointly += e @ np.linalg.solve(fit.load.covariance, e) <= 22.36  # 95 % of chi-squared, 13
        worst = np.maximum(worst, np.abs(e))
    print(f"inside 95 %: mass {inside[0]:.0f}, centre {inside[1:4]}, bias {inside[4:10]}, "
          f"frame {inside[10:]}, all {jointly} of 100; worst mass {1e3 * worst[0]:.2f} g, centre "
          f"{1e3 * worst[1:4].max():.2f} mm, bias {worst[4:7].max():.4f} N "
          f"{worst[7:10].max():.5f} N m, frame {np.degrees(worst[10:].max()):.3f} deg")  # fmt: skip
    assert (inside >= 90).all()
    assert jointly >= 90


@pytest.mark.parametrize("seed", range(5))
def test_a_tool_that_was_pressed_in_one_posture_is_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    case, sensor = case_of(rng)
    with pytest.raises(CalibrationError, match=r"posture 1 is .* let it hang free"):
        solve_load(postures(case, rng, push=np.array([0.0, 0.5, 0.5])), sensor)


def test_too_few_postures_and_postures_from_one_side_are_refused() -> None:
    rng = np.random.default_rng(2)
    case, sensor = case_of(rng)
    with pytest.raises(CalibrationError, match="11 postures; at least 12"):
        solve_load(postures(case, rng, 11), sensor)
    same = [dataclasses.replace(postures(case, rng, 1)[0], g_F=np.array([0.0, 0.1 * k, -9.8]))
            for k in range(12)]  # fmt: skip
    with pytest.raises(CalibrationError, match=r"condition .* too few sides"):
        solve_load(same, sensor)


def test_a_sensor_that_is_noisier_than_its_file_states_a_wider_interval() -> None:
    rng = np.random.default_rng(3)
    case, sensor = case_of(rng)
    quiet = solve_load(postures(case, rng, 20), sensor)
    noisy = [dataclasses.replace(p, reading=p.reading + 10 * NOISE / 16 * rng.normal(size=6))
             for p in postures(case, rng, 20)]  # fmt: skip
    loud = solve_load(noisy, sensor)
    assert loud.residual > 4.0
    assert loud.load.covariance[0, 0] > 10.0 * quiet.load.covariance[0, 0]


def test_zero_takes_up_a_drift_and_refuses_contact() -> None:
    rng = np.random.default_rng(4)
    worst = 0.0
    for _ in range(20):
        case, sensor = case_of(rng)
        load = solve_load(postures(case, rng), sensor).load
        drifted = dataclasses.replace(case, bias=case.bias + DRIFT * rng.uniform(-1.5, 1.5, 6))
        fresh, _ = zero(load, postures(drifted, rng, 4), sensor, hours=1.0)
        worst = max(worst, float(np.abs(fresh.bias - drifted.bias)[:3].max()))
        assert fresh.mass == load.mass
        with pytest.raises(CalibrationError, match="touches something"):  # pressed in one posture
            zero(load, postures(drifted, rng, 4, np.array([0.3, 0.3, 0.3])), sensor, 1.0)
        leaning = [
            dataclasses.replace(p, reading=p.reading + np.array([1.0, 0, 0, 0, 0.2, 0]))
            for p in postures(case, rng, 4)
        ]
        with pytest.raises(CalibrationError, match="mean of all postures"):  # in all alike
            zero(load, leaning, sensor, 1.0)
        with pytest.raises(CalibrationError, match="2 postures"):
            zero(load, postures(case, rng, 2), sensor, 1.0)
    print(f"zero: worst {worst:.4f} N")
    assert worst < 0.03


def calibration(tmp_path: Path) -> tuple[ForceCalibration, Path, Path]:
    rng = np.random.default_rng(5)
    case, sensor = case_of(rng)
    fit = solve_load(postures(case, rng), sensor)
    tool, yaml = tmp_path / "tool_PSM1.yaml", tmp_path / "sensor.yaml"
    tool.write_text("a tool\n")
    yaml.write_text("a sensor\n")
    hashes = [hashlib.sha256(f.read_bytes()).hexdigest() for f in (tool, yaml)]
    found = ForceCalibration(
        fit.load, fit.residual, fit.condition, fit.n, "2026-11-23", "2026-11-23T12:00:00",
        "simulated", *hashes,
    )  # fmt: skip
    return found, tool, yaml


def test_a_file_that_was_written_reads_back_bit_for_bit(tmp_path: Path) -> None:
    found, tool, sensor = calibration(tmp_path)
    file = tmp_path / "force_PSM1.yaml"
    write_force(file, found, "Measured")
    again = load_force(file)
    for name in ("mass", "p_SCom", "bias", "p_FS", "covariance"):
        np.testing.assert_array_equal(getattr(again.load, name), getattr(found.load, name))
    np.testing.assert_allclose(again.load.R_FS, found.load.R_FS, atol=1e-15)
    later = datetime.datetime(2026, 11, 23, 13, 30, tzinfo=datetime.UTC)
    assert again.hours_since_zero(later) == pytest.approx(1.5)
    assert again.hours_since_zero(later - datetime.timedelta(days=1)) == 0.0
    check_current(again, file, tool, sensor)


@pytest.mark.parametrize("which", ["tool_sha256", "sensor_sha256"])
def test_a_calibration_older_than_its_tool_or_sensor_is_refused(tmp_path: Path, which: str) -> None:
    found, tool, sensor = calibration(tmp_path)
    (tool if which == "tool_sha256" else sensor).write_text("another one\n")
    with pytest.raises(ConfigError, match=f"{which}: .*Repeat ./surg calibrate CELL force"):
        check_current(found, "force_PSM1.yaml", tool, sensor)


@pytest.mark.parametrize(
    ("was", "now", "key"),
    [
        ("mass: ", "mass: -", "mass"),
        ("n: 12", "n: 11", "n"),
        ("zeroed: \"2026-11-23T", "zeroed: \"2026-13-23T", "zeroed"),
        ("covariance: [\n  [", "covariance: [\n  [", ""),
        ("source: simulated", "source: guessed", "source"),
        ("bias: [", "bias: [.nan, ", "bias"),
    ],
)  # fmt: skip
def test_what_a_file_must_not_state_is_refused_by_its_key(
    tmp_path: Path, was: str, now: str, key: str
) -> None:
    found, *_ = calibration(tmp_path)
    file = tmp_path / "force_PSM1.yaml"
    write_force(file, found, "Measured")
    text = file.read_text("utf-8")
    if not key:  # a covariance that is none
        head, tail = text.split("covariance: [")
        numbers = tail.split("]", 1)
        text, key = f"{head}covariance: [{', '.join(['0.1'] * 169)}]{numbers[1]}", "covariance"
    else:
        assert was in text
        text = text.replace(was, now)
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=f": {key}: "):
        load_force(file)
