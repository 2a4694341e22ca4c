"""Bundle adjustment over views, with the covariance by a jackknife over views.

Each view has residuals that depend on parameters that all views share (a lens, a hand-eye pose)
and on parameters of its own (where the board was). The own parameters are eliminated by the Schur
complement (D. C. Brown, 1958; B. Triggs et al., "Bundle adjustment", 2000), so that each view
leaves a small normal equation in the shared parameters. Without one view's equation, the solution
moves by one Gauss-Newton step: that is the jackknife (B. Efron, 1982) at the cost of one fit.

Corners of one view share its errors: the arm's pose, the light, the board's bending. A covariance
from the residuals of all corners takes them as independent and is several times too small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from surg_core.transforms import FloatArray

MOST_STEPS = 40
SETTLED = 1e-8
"""Share of the cost below which a change ends the iteration."""
_T = TypeVar("_T", bound="Problem")


class Problem(Protocol):
    """Residuals of views at one set of parameters."""

    @property
    def views(self) -> int:
        """Number of views."""

    def linearise(self, view: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (m,), derivatives by the shared (m, s) and by the own parameters (m, o)."""

    def moved(self: _T, shared: FloatArray, own: list[FloatArray]) -> _T:
        """The problem after a step of the shared (s,) and of each view's own parameters (o,)."""


@dataclass(frozen=True)
class Adjusted(Generic[_T]):
    """The solution with what each view says.

    Attributes:
        solution: The problem at the solution.
        normal: ``(n, s, s)`` reduced normal matrix of each view.
        gradient: ``(n, s)`` reduced gradient of each view.
        residuals: The residuals of each view, (m,).
    """

    solution: _T
    normal: FloatArray
    gradient: FloatArray
    residuals: list[FloatArray]

    @property
    def rms(self) -> float:
        """Root mean square residual of a corner, over both of its coordinates."""
        total = np.concatenate(self.residuals)
        return float(np.sqrt(2.0 * np.mean(total**2)))

    def without(self) -> FloatArray:
        """Steps ``(n, s)`` of the shared parameters to the solution without each view."""
        normal, gradient = self.normal.sum(axis=0), self.gradient.sum(axis=0)
        return np.array(
            [
                -_solve(normal - N, gradient - g)
                for N, g in zip(self.normal, self.gradient, strict=True)
            ]
        )

    @property
    def covariance(self) -> FloatArray:
        """Covariance ``(s, s)`` of the shared parameters, by jackknife over views."""
        return jackknife(self.without())

    @property
    def covariance_of_corners(self) -> FloatArray:
        """Covariance ``(s, s)`` as if all corners were independent: too small, for comparison."""
        total = np.concatenate(self.residuals)
        variance = float(total @ total) / max(1, len(total) - len(self.normal[0]))
        return np.asarray(variance * np.linalg.pinv(self.normal.sum(axis=0), hermitian=True))

    @property
    def condition(self) -> float:
        """Largest over smallest sensitivity of the shared parameters, each in units of its own."""
        N = self.normal.sum(axis=0)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(N), 1e-300))
        values = np.linalg.eigvalsh(scale[:, None] * N * scale)
        return float(np.sqrt(values[-1] / max(values[0], 1e-300)))


def jackknife(steps: FloatArray) -> FloatArray:
    """Covariance ``(s, s)`` from the steps ``(n, s)`` that leave one of n views out."""
    n = len(steps)
    away = steps - steps.mean(axis=0)
    return np.asarray((n - 1) / n * away.T @ away)


def adjust(problem: _T) -> Adjusted[_T]:
    """Minimise the sum of squared residuals by Levenberg-Marquardt steps."""
    damping = 1e-3
    present = _linearised(problem)
    for _ in range(MOST_STEPS):
        shared, own = _step(present, damping)
        moved = problem.moved(shared, own)
        after = _linearised(moved)
        better = _cost(after) < _cost(present)
        settled = abs(_cost(present) - _cost(after)) <= SETTLED * _cost(present)
        if better:
            problem, present, damping = moved, after, max(1e-12, 0.1 * damping)
        else:
            damping *= 10.0
        if settled or damping > 1e9:
            break
    normal, gradient = zip(*(_reduced(*each, 0.0)[:2] for each in present), strict=True)
    return Adjusted(problem, np.array(normal), np.array(gradient), [each[0] for each in present])


_Linear = list[tuple[FloatArray, FloatArray, FloatArray]]


def _linearised(problem: Problem) -> _Linear:
    return [problem.linearise(view) for view in range(problem.views)]


def _cost(linear: _Linear) -> float:
    cost = sum(float(r @ r) for r, _, _ in linear)
    return cost if np.isfinite(cost) else float("inf")


def _reduced(
    r: FloatArray, by_shared: FloatArray, by_own: FloatArray, damping: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Normal matrix (s, s) and gradient (s,) without the own parameters, and how to get these."""
    N, g = by_shared.T @ by_shared, by_shared.T @ r
    C = by_own.T @ by_own
    C += damping * np.diag(np.diag(C))
    mixed = by_own.T @ by_shared
    both = _solve(C, np.column_stack([mixed, by_own.T @ r]))
    return N - mixed.T @ both[:, :-1], g - mixed.T @ both[:, -1], both[:, :-1], both[:, -1]


def _step(linear: _Linear, damping: float) -> tuple[FloatArray, list[FloatArray]]:
    """A damped Gauss-Newton step of the shared and of all own parameters."""
    reduced = [_reduced(*each, damping) for each in linear]
    normal = sum((each[0] for each in reduced), np.zeros_like(reduced[0][0]))
    gradient = sum((each[1] for each in reduced), np.zeros_like(reduced[0][1]))
    scale = sum((np.sum(each[1] ** 2, axis=0) for each in linear), np.zeros(len(gradient)))
    shared = -_solve(normal + damping * np.diag(scale), gradient)
    return shared, [-(own + by_shared @ shared) for _, _, by_shared, own in reduced]


def _solve(A: FloatArray, b: FloatArray) -> FloatArray:
    """Solve a symmetric system, scaled to a unit diagonal; the least solution where singular."""
    if not len(A):
        return np.zeros_like(b)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = scale[:, None] * A * scale
    right = scale * b if b.ndim == 1 else scale[:, None] * b
    try:
        found = np.linalg.solve(scaled, right)
    except np.linalg.LinAlgError:
        found = np.linalg.lstsq(scaled, right, rcond=1e-12)[0]
    return np.asarray(scale * found if b.ndim == 1 else scale[:, None] * found)
