"""Pages about the steps of a calibration: residuals, poses in space, expected errors.

Each page is one HTML file that loads nothing from outside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

import surg_core
from surg_core.stereo_file import HELD_OUT_DISTANCES
from surg_core.transforms import FloatArray, inverse_pose
from surg_perception.calibration.bases import SeenBase
from surg_perception.calibration.board import Board
from surg_perception.calibration.chain import DISTANCE, ChainError
from surg_perception.calibration.evidence import coverage
from surg_perception.calibration.handeye import HandEyeFit
from surg_perception.calibration.intrinsics import LensFit, SeenCorners
from surg_perception.calibration.small_motions import shift_at, transform
from surg_perception.calibration.stereo import StereoFit
from surg_perception.output.report_drawing import (
    BLACK,
    Colour,
    Drawing,
    Line,
    above_and_side,
    bars,
    colour,
    front_and_side,
    residuals_in_picture,
    residuals_in_space,
)
from surg_recording.reports.figure_style import encoded
from surg_recording.reports.html_page import document, grid, picture, section
from surg_recording.reports.html_page import facts as table_of

SIGHT = 0.015
"""[m] Length of the line that shows where an eye looks."""
_AT_80 = f"expected error at {1e3 * DISTANCE:g} mm"


def camera_page(result: LensFit, board: Board, title: str) -> str:
    """Residuals in the only eye, and the board before it."""
    lens, problem = result.lens, result.fit.solution
    facts = {
        "lens": lens.model,
        "views": str(len(result.fit.residuals)),
        "rms": f"{result.fit.rms:.3f} px",
        "held out": f"{result.held_out:.3f} px",
        _AT_80: f"{1e3 * DISTANCE * result.held_out / lens.values[0]:.3f} mm across the sight",
    }
    nothing = SeenCorners(np.zeros((0, 3)), np.zeros((0, 2)))
    (left,) = _eyes([(each, nothing) for each in problem.seen], result.fit.residuals, lens.size)
    return _page(title, facts, [left, *_boards(problem.X_CBoard, board)])


def stereo_page(result: StereoFit, board: Board, title: str) -> str:
    """Residuals in both eyes, the board before the left eye, held-out errors by distance."""
    fit, stereo = result.fit, result.stereo
    turn, shift = result.pose_error
    facts = {
        "lens": stereo.left.model,
        "baseline": f"{1e3 * stereo.baseline:.4f} mm",
        "expected error of the right eye's pose": _pose_error(turn, shift),
        "views": str(len(fit.residuals)),
        "rms": f"{fit.rms:.3f} px",
        "held out": f"{result.held_out:.3f} px",
        "rows, left against right": f"{result.rows:.3f} px",
        **{
            f"held-out corners at {1e3 * z:g} mm": f"{1e3 * result.error_at(z):.3f} mm (median)"
            for z in HELD_OUT_DISTANCES
        },
        _AT_80: f"{1e3 * result.error_at(DISTANCE) / 0.6745:.3f} mm (1 sigma), of the pictures",
    }
    drawings = [
        *_eyes(fit.solution.seen, fit.residuals, stereo.left.size),
        *_boards(fit.solution.X_LBoard, board),
    ]
    return _page(title, facts, drawings)


def handeye_page(result: HandEyeFit, board: Board, title: str) -> str:
    """Residuals in both eyes, and where the eye stood around the board."""
    problem = result.fit.solution
    turn, shift = result.pose_error
    factors = [
        f"{100 * (factor - 1):+.2f} ± {100 * sd:.2f} %"
        for factor, sd in zip(result.factors, result.factors_sd, strict=True)
    ]
    position = ", ".join(f"{1e3 * value:.3f}" for value in result.X_FV[:3, 3])
    at = shift_at(result.of_views, result.X_FV[:3, :3] @ [0.0, 0.0, DISTANCE])
    facts = {
        "left eye in the flange": f"[{position}] mm",
        "expected error": _pose_error(turn, shift),
        "views": str(len(result.fit.residuals)),
        "rms": f"{result.fit.rms:.3f} px",
        "turns": " and ".join(f"{value:.0f} deg" for value in np.degrees(result.turns)),
        "a focal length that would fit better": factors[0],
        "a board size that would fit better": factors[1],
        _AT_80: f"{1e3 * at:.3f} mm (1 sigma), of the camera's pose",
    }
    X_BoardV = inverse_pose(problem.X_BBoard) @ problem.X_BF @ result.X_FV
    lines = [Line(_outline(board), BLACK, "board")]
    lines += [_eye(X, colour(view), str(view + 1)) for view, X in enumerate(X_BoardV)]
    drawings = [
        *_eyes(problem.seen, result.fit.residuals, problem.stereo.left.size),
        *front_and_side(lines, "frame of the board"),
    ]
    return _page(title, facts, drawings)


def bases_page(result: SeenBase, chain: ChainError | None, title: str) -> str:
    """What remains between both arms' points, before the scope's first posture.

    Args:
        result: The fit.
        chain: Of the cell, if all of its files are there.
        title: Of the page.
    """
    turn, shift = result.error
    facts = {
        "points": str(result.n),
        "rms": f"{1e3 * result.rms:.3f} mm",
        "expected error amid the points": _pose_error(turn, shift),
        "extent of the points (rms)": ", ".join(f"{1e3 * s:.1f}" for s in result.spread) + " mm",
    }
    if chain is not None:
        facts[f"joints and picture at {1e3 * DISTANCE:g} mm"] = _within(chain)
    X_VS = inverse_pose(result.X_SV)
    p_V = transform(X_VS, result.p_S)
    names = [str(number + 1) for number in range(result.n)]
    arrows, factor = residuals_in_space(p_V, result.residuals @ X_VS[:3, :3].T, names)
    lines = [_eye(np.eye(4), BLACK, "left eye"), *arrows]
    drawings = above_and_side(lines, f"frame of the left eye; residuals {factor:g} times as long")
    return _page(title, facts, drawings + ([] if chain is None else [_parts(chain)]))


def chain_page(cell: surg_core.Cell, X_WV: FloatArray, chain: ChainError, title: str) -> str:
    """The parts of the chain's error, and the arms, the eye and the place in the world.

    Args:
        cell: The cell.
        X_WV: The left eye at the scope's home posture (4, 4).
        chain: The expected errors.
        title: Of the page.
    """
    facts = {f"joints and picture at {1e3 * DISTANCE:g} mm": _within(chain)}
    place = (X_WV @ [0.0, 0.0, DISTANCE, 1.0])[:3]
    lines = [Line(np.array([X_WV[:3, 3], place]), BLACK, "80 mm", dot=True)]
    for number, arm in enumerate(cell.arms.values()):
        base, tip = arm.X_WB[:3, 3], X_WV[:3, 3] if arm.instrument.camera is not None else place
        lines.append(Line(np.array([tip, base]), colour(number), f"base of {arm.name}"))
    return _page(title, facts, [*front_and_side(lines, "world"), _parts(chain)])


def _page(title: str, facts: Mapping[str, str], drawings: Sequence[Drawing]) -> str:
    """The page: facts as a table, then the drawings."""
    pictures = [
        picture(*encoded(drawing.figure), name=drawing.title, caption=drawing.title)
        for drawing in drawings
    ]
    shown = [table_of(facts.items()), grid(pictures, "two")]
    return document(title, [section("Result", *shown)])


def _within(chain: ChainError) -> str:
    return f"agree within {1e3 * chain.two_sigma:.2f} mm (2 sigma)"


def _parts(chain: ChainError) -> Drawing:
    """Bars of the parts and of their sum."""
    parts = {"tool": chain.tool, "bases": chain.base, "hand-eye": chain.handeye}
    parts |= {"stereo": chain.stereo, "all, 2 sigma": chain.two_sigma}
    in_mm = {name: 1e3 * value for name, value in parts.items()}
    return bars(f"{_AT_80}, 1 sigma of each part", in_mm, "mm")


def _pose_error(turn: float, shift: float) -> str:
    return f"{1e3 * shift:.3f} mm, {np.degrees(turn):.3f} deg (1 sigma)"


def _boards(X_LBoard: Sequence[FloatArray], board: Board) -> list[Drawing]:
    """The rim of the board in each view, before the left eye."""
    rims = [
        Line(transform(X, _outline(board)), colour(view), str(view + 1))
        for view, X in enumerate(X_LBoard)
    ]
    return above_and_side([_eye(np.eye(4), BLACK, "left eye"), *rims], "frame of the left eye")


def _outline(board: Board) -> FloatArray:
    """The rim of the pattern, from its lower left corner and back (5, 3) [m]."""
    wide, high = board.size
    return np.array([[0, 0, 0], [wide, 0, 0], [wide, high, 0], [0, high, 0], [0, 0, 0]])


def _eye(X: FloatArray, stroke: Colour, label: str) -> Line:
    """An eye as a dot with a line along its axis."""
    return Line(transform(X, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, SIGHT]])), stroke, label, True)


def _eyes(
    seen: Sequence[tuple[SeenCorners, SeenCorners]],
    residuals: Sequence[FloatArray],
    size: tuple[int, int],
) -> list[Drawing]:
    """The residuals of the left and of the right eye; a view's residuals state the left first."""
    drawings = []
    for eye, name in enumerate(("left", "right")):
        corners = [view[eye] for view in seen]
        firsts = [len(view[0].pixels) for view in seen]
        both = [r.reshape(-1, 2) for r in residuals]
        if not any(len(each.pixels) for each in corners):
            continue  # an endoscope with one eye
        own = [r[:n] if eye == 0 else r[n:] for r, n in zip(both, firsts, strict=True)]
        reached = ", ".join(f"{value:.2f}" for value in coverage(corners, size))
        title = f"{name} eye: corners reach {reached} of the half height (quarters)"
        drawings.append(residuals_in_picture(title, size, corners, own))
    return drawings
