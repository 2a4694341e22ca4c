"""Reference statics of a tool on a force sensor, by homogeneous points and `np.cross` alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GRAVITY = np.array([0.0, 0.0, -9.80665])


def rotation(rng: np.random.Generator) -> Array:
    """A rotation matrix drawn evenly."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def turn(v: Array) -> Array:
    """exp([v]) by its power series."""
    x, y, z = v
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    term, total = np.eye(3), np.eye(3)
    for k in range(1, 20):
        term = term @ K / k
        total = total + term
    return total


@dataclass
class Situation:
    """A tool in a trocar: where it is, and what pulls at it."""

    mass: float
    p_SCom: Array
    bias: Array
    R_FS: Array
    p_FS: Array
    s_F: Array
    p_FTip: Array
    X_BF: Array
    depth: float
    tip: Array  # (3,) force on the tip, base axes
    trocar: Array  # (3,) force on the shaft at the trocar
    g: Array

    @property
    def s(self) -> Array:
        """Unit shaft axis, (3,)."""
        return self.X_BF[:3, :3] @ self.s_F

    @property
    def p_Tip(self) -> Array:
        """Tip [m], (3,)."""
        return self.X_BF[:3, :3] @ self.p_FTip + self.X_BF[:3, 3]

    @property
    def p_Rcm(self) -> Array:
        """Trocar's point on the shaft [m], (3,)."""
        return self.p_Tip - self.depth * self.s

    def across(self, v: Array) -> Array:
        """The part of a force across the shaft."""
        return v - (v @ self.s) * self.s

    def reading(self) -> Array:
        """What the sensor shows: forces summed, moments about its origin, in its axes."""
        R_BS = self.X_BF[:3, :3] @ self.R_FS
        origin = self.X_BF[:3, 3] + self.X_BF[:3, :3] @ self.p_FS
        com = origin + R_BS @ self.p_SCom
        pulls = [(self.p_Tip, self.tip), (self.p_Rcm, self.trocar), (com, self.mass * self.g)]
        force = np.sum([f for _, f in pulls], axis=0)
        moment = np.sum([np.cross(p - origin, f) for p, f in pulls], axis=0)
        return np.concatenate([R_BS.T @ force, R_BS.T @ moment]) + self.bias


def drawn(rng: np.random.Generator) -> Situation:
    """A situation of ordinary sizes."""
    s_F = np.array([0.0, 0.0, 1.0]) + 0.2 * rng.normal(size=3)
    X_BF = np.eye(4)
    X_BF[:3, :3], X_BF[:3, 3] = rotation(rng), rng.uniform(-0.6, 0.6, 3)
    return Situation(
        mass=rng.uniform(0.1, 1.5),
        p_SCom=rng.uniform(-0.08, 0.08, 3),
        bias=np.concatenate([rng.uniform(-5, 5, 3), rng.uniform(-0.3, 0.3, 3)]),
        R_FS=rotation(rng),
        p_FS=rng.uniform(-0.05, 0.05, 3),
        s_F=s_F / np.linalg.norm(s_F),
        p_FTip=np.array([0.06, 0.0, 0.3]) + 0.05 * rng.normal(size=3),
        X_BF=X_BF,
        depth=rng.uniform(0.02, 0.15),
        tip=rng.uniform(-5, 5, 3),
        trocar=rng.uniform(-10, 10, 3),
        g=rotation(rng) @ GRAVITY,
    )
