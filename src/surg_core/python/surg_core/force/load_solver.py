"""Measures a tool's mass, centre of mass, bias and frame on its sensor, from postures at rest.

A posture is a flange orientation and the mean reading of the free tool in it. Forces show mass,
frame and bias; moments then show the centre. The height of the sensor above the flange does not
show, since weight has no place along its own direction: it comes from the drawing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surg_core._core import CalibrationError
from surg_core.force.compensation import PARAMETERS, ToolLoad
from surg_core.force.sensor_file import ForceSensor
from surg_core.transforms import FloatArray, rotation_of, skew

LEAST_POSTURES = 12
LEAST_TO_ZERO = 3
LARGEST_CONDITION = 30.0
"""Of the directions of gravity in the sensor; 1 is best. A worse one hides bias behind weight."""
FREE_SIGMAS = 4.0
"""A zero that moved by more standard deviations of its drift is no drift."""
OUTLIER_SIGMAS = 6.0
"""A posture that is further off was no free tool's."""
ITERATIONS = 20
POSTURE_SD = 3e-4
"""[rad] Of a flange's orientation by an arm's kinematics; assumed."""


@dataclass(frozen=True, eq=False)
class Posture:
    """A free tool at rest.

    Attributes:
        g_F: (3,) gravity in the flange [m/s^2].
        reading: (6,) mean reading, of the tool on the sensor [N, N m].
        n: Readings in that mean.
    """

    g_F: FloatArray
    reading: FloatArray
    n: int


@dataclass(frozen=True, eq=False)
class LoadFit:
    """A measured load.

    Attributes:
        load: With its covariance.
        residual: Root of the mean squared residual in standard deviations; 1 is a free tool.
        force_rms: Of the force residuals [N].
        moment_rms: Of the moment residuals [N m].
        condition: Largest over smallest spread of gravity in the sensor; 1 is best.
        n: Postures.
    """

    load: ToolLoad
    residual: float
    force_rms: float
    moment_rms: float
    condition: float
    n: int


def solve_load(postures: Sequence[Posture], sensor: ForceSensor) -> LoadFit:
    """Mass, centre of mass, bias and frame from at least 12 postures.

    Raises:
        CalibrationError: Too few postures, gravity from too few sides, or a tool that was not
            free; says which and what to do.
    """
    if len(postures) < LEAST_POSTURES:
        raise CalibrationError(
            f"{len(postures)} postures; at least {LEAST_POSTURES} are needed, turned about two "
            "horizontal axes"
        )
    condition = _condition(postures)
    if not condition <= LARGEST_CONDITION:
        raise CalibrationError(
            f"condition {condition:.3g}; allowed: at most {LARGEST_CONDITION:g}: gravity pulled "
            "from too few sides. Add postures with the flange turned further about two axes"
        )
    x, R_FS = _start(postures, sensor)
    for _ in range(ITERATIONS):
        J, e = _linearised(postures, sensor, x, R_FS)
        step = np.linalg.solve(J.T @ J, J.T @ e)
        x = x + step[:10]
        R_FS = R_FS @ rotation_of(step[10:])
        if np.abs(step).max() < 1e-9:
            break
    J, e = _linearised(postures, sensor, x, R_FS)
    residual = float(np.sqrt(e @ e / (6 * len(postures) - PARAMETERS)))
    _refuse_contact(np.abs(e).reshape(-1, 6))
    # A residual above one says that the sensor is noisier than its file: believe the data.
    covariance = np.linalg.inv(J.T @ J) * max(1.0, residual) ** 2
    load = ToolLoad(float(x[0]), x[1:4], x[4:10], R_FS, sensor.X_FS[:3, 3], covariance)
    rms = _rms(postures, load)
    return LoadFit(load, residual, rms[0], rms[1], condition, len(postures))


def zero(
    load: ToolLoad, postures: Sequence[Posture], sensor: ForceSensor, hours: float
) -> tuple[ToolLoad, float]:
    """A new bias for a tool that is known, from a few postures of the free tool.

    Contact is recognised in two ways: what presses on the tool turns with it otherwise than a bias
    does, so the postures disagree; and a zero drifts, but not further than the sensor's file says.

    Args:
        load: As calibrated.
        postures: At least three.
        sensor: Its noise and drift.
        hours: Since the last zero.

    Returns:
        The load with the new bias, and the residual in standard deviations.

    Raises:
        CalibrationError: The tool touches something, or there are too few postures.
    """
    if len(postures) < LEAST_TO_ZERO:
        raise CalibrationError(
            f"{len(postures)} postures; at least {LEAST_TO_ZERO} are needed to tell a free tool "
            "from one that touches something"
        )
    off = np.array([p.reading - load.bias - _weight(load, p) for p in postures])
    by_turn = _by_turn(np.array([p.g_F for p in postures]) @ load.R_FS, load.mass, load.p_SCom)
    white = _whitening(postures, sensor, by_turn)
    information = white.transpose(0, 2, 1) @ white
    mean_covariance = np.linalg.inv(information.sum(axis=0))
    shift = mean_covariance @ (information @ off[:, :, None]).sum(axis=0)[:, 0]
    sigmas = np.abs(white @ (off - shift)[:, :, None])[:, :, 0]
    residual = float(np.sqrt((sigmas**2).sum() / (6 * len(postures) - 6)))
    _refuse_contact(sigmas)
    calibrated = np.sqrt(np.diag(load.covariance)[4:10])
    fresh = np.diag(mean_covariance)
    drift = np.sqrt(sensor.drift**2 * max(hours, 0.0) + calibrated**2 + fresh)
    moved = np.abs(shift) / drift
    if moved.max() > FREE_SIGMAS:
        raise _contact("the mean of all postures", float(moved.max()), FREE_SIGMAS)
    covariance = np.array(load.covariance)
    covariance[4:10, :] = covariance[:, 4:10] = 0.0
    covariance[4:10, 4:10] = np.diag(fresh + calibrated**2)
    bias = load.bias + shift
    return ToolLoad(load.mass, load.p_SCom, bias, load.R_FS, load.p_FS, covariance), residual


def _contact(where: str, sigmas: float, allowed: float) -> CalibrationError:
    return CalibrationError(
        f"{where} is {sigmas:.1f} standard deviations off the free tool; allowed: "
        f"{allowed:g}. The tool touches something, or was changed: let it hang free and "
        "repeat, or calibrate again"
    )


def _condition(postures: Sequence[Posture]) -> float:
    """Of the directions of gravity, with a constant beside them for the bias."""
    directions = np.array([p.g_F / np.linalg.norm(p.g_F) for p in postures])
    columns = np.hstack([directions * np.sqrt(3.0), np.ones((len(postures), 1))])
    spread = np.linalg.svd(columns, compute_uv=False)
    return float(spread[0] / spread[-1]) if spread[-1] > 0.0 else float("inf")


def _start(postures: Sequence[Posture], sensor: ForceSensor) -> tuple[FloatArray, FloatArray]:
    """First values (10,) and frame: linear fits with the frame of the drawing."""
    R_FS = np.array(sensor.X_FS[:3, :3])
    rows, values = [], []
    for p in postures:
        g = R_FS.T @ p.g_F
        row = np.zeros((6, 10))
        row[:3, 0], row[3:, 1:4] = g, -skew(g)  # the moments' unknown is mass times centre
        row[:, 4:] = np.eye(6)
        rows.append(row)
        values.append(p.reading)
    x = np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=None)[0]
    if not x[0] > 0.0:
        raise CalibrationError(
            f"the mass comes out as {x[0]:.4g} kg; a positive one is needed. Check `reading` and "
            "`quaternion` of the sensor's file"
        )
    x[1:4] /= x[0]
    return x, R_FS


def _linearised(
    postures: Sequence[Posture], sensor: ForceSensor, x: FloatArray, R_FS: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Derivative (6 n, 13) and residual (6 n,) of all readings, in standard deviations."""
    n, m, c = len(postures), x[0], x[1:4]
    g = np.array([p.g_F for p in postures]) @ R_FS
    by_turn = _by_turn(g, m, c)
    J = np.zeros((n, 6, PARAMETERS))
    J[:, :3, 0], J[:, 3:, 0] = g, np.cross(c, g)
    J[:, 3:, 1:4] = -by_turn[:, :3]
    J[:, :, 4:10] = np.eye(6)
    J[:, :, 10:] = by_turn
    model = np.hstack([m * g, m * np.cross(c, g)]) + x[4:10]
    errors = np.array([p.reading for p in postures]) - model
    white = _whitening(postures, sensor, by_turn)
    return (white @ J).reshape(6 * n, -1), (white @ errors[:, :, None]).ravel()


def _by_turn(g: FloatArray, m: float, c: FloatArray) -> FloatArray:
    """(n, 6, 3) derivative of the weight's reading by a turn of the sensor; g (n, 3) in S."""
    turned = m * skew(g)
    return np.concatenate([turned, skew(c) @ turned], axis=1)


def _whitening(postures: Sequence[Posture], sensor: ForceSensor, by_turn: FloatArray) -> FloatArray:
    """(n, 6, 6) that make a posture's errors standard: of the noise, and of the arm's own turn."""
    noise = np.array([np.diag(sensor.noise**2 / p.n) for p in postures])
    covariance = noise + POSTURE_SD**2 * by_turn @ by_turn.transpose(0, 2, 1)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def _refuse_contact(sigmas: FloatArray) -> None:
    """A posture in which the tool touched something stands out; sigmas (n, 6), not negative.

    A sensor that is noisier than its file says is not in contact: its own spread is the measure.
    """
    usual = max(1.0, 1.5 * float(np.median(sigmas)))
    worst = sigmas.max(axis=1)
    if worst.max() > OUTLIER_SIGMAS * usual:
        raise _contact(f"posture {int(worst.argmax()) + 1}", float(worst.max()), OUTLIER_SIGMAS)


def _weight(load: ToolLoad, posture: Posture) -> FloatArray:
    return load.weight(load.R_FS.T @ posture.g_F)


def _rms(postures: Sequence[Posture], load: ToolLoad) -> tuple[float, float]:
    off = np.array([p.reading - load.bias - _weight(load, p) for p in postures])
    return float(np.sqrt(np.mean(off[:, :3] ** 2))), float(np.sqrt(np.mean(off[:, 3:] ** 2)))
