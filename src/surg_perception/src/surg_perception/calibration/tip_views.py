"""The tip in a folder of views: stated in its table, or found in its pictures."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

import surg_core
from surg_core.transforms import FloatArray, rotation_vector
from surg_perception.calibration import evidence
from surg_perception.calibration.small_motions import transform
from surg_perception.calibration.tip_finder import NotSeen, Picture, TipScene, find_tip
from surg_perception.calibration.triangulation import Stereo, rigid_fit
from surg_perception.calibration.views import EYES, View, Views, ViewsError

MOST_SHIFT, MOST_TURN = 5e-4, np.radians(0.1)
"""[m], [rad] Largest motion of the endoscope's flange between two rests."""
MISFIT = 0.003
"""[m] Largest distance from where the views that agree put the tip."""
MOST_TRIPLES = 5000


def seen_tips(
    views: Views, eyes: Stereo, X_SF: FloatArray, s_V: FloatArray
) -> tuple[list[View], FloatArray, list[str]]:
    """The tip in each view that shows it.

    Args:
        views: Of a folder.
        eyes: Both lenses and the pose between them.
        X_SF: (n, 4, 4) flange of the scope's arm, of each view.
        s_V: (n, 3) direction of the shaft before the left eye, of each view, roughly.

    Returns:
        The views, the tip before the left eye (m, 3) [m], and why others are left out.

    Raises:
        Refused: The endoscope moved between the rests.
        ViewsError: A picture must not be used.
    """
    if all(view.tip is not None for view in views.views):
        tips = np.array([view.tip for view in views.views])
        return list(views.views), eyes.triangulate(tips[:, :2], tips[:, 2:]), []
    _still(X_SF)
    pairs = [_pair(views, view) for view in views.views]
    scene = TipScene.of([left for left, _ in pairs])
    used, found, left_out = [], [], []
    for view, pair, s in zip(views.views, pairs, s_V, strict=True):
        try:
            found.append(find_tip(scene, pair, eyes, s))
            used.append(view)
        except NotSeen as why:
            left_out.append(f"{view.name}: {why}")
    return used, np.array(found).reshape(-1, 3), left_out


def shaft_directions(
    scope: surg_core.Arm, tool: surg_core.Arm, X_SV: FloatArray, R_TF: FloatArray
) -> FloatArray:
    """Direction (n, 3) of the shaft before the left eye, as the bases are believed.

    Args:
        scope: The arm that holds the endoscope.
        tool: The arm of the instrument.
        X_SV: (n, 4, 4) the left eye in the base of the scope's arm.
        R_TF: (n, 3, 3) the flange in the base of the instrument's arm.
    """
    R_ST = np.asarray(scope.X_WB)[:3, :3].T @ np.asarray(tool.X_WB)[:3, :3]
    s_S = R_TF @ np.asarray(tool.tool.s_F) @ R_ST.T
    return np.einsum("nji,nj->ni", X_SV[:, :3, :3], s_S)


def fitting(p_S: FloatArray, p_T: FloatArray) -> NDArray[np.bool_]:
    """The most places (n,) that fit one rigid motion: in the others the tip was not what was found.

    Args:
        p_S: (n, 3) as the scope sees them [m].
        p_T: (n, 3) by the joints [m].
    """
    best = np.zeros(len(p_S), dtype=bool)
    for three in itertools.islice(itertools.combinations(range(len(p_S)), 3), MOST_TRIPLES):
        chosen = list(three)
        X_ST = rigid_fit(p_T[chosen], p_S[chosen])
        fits = np.linalg.norm(p_S - transform(X_ST, p_T), axis=1) <= MISFIT
        if fits.sum() > best.sum():
            best = fits
    return best


def _still(X_SF: FloatArray) -> None:
    """Refuse a scope that moved: what moves in the picture must be the instrument."""
    shift = float(np.linalg.norm(X_SF[:, :3, 3] - X_SF[0, :3, 3], axis=1).max())
    turn = max(float(np.linalg.norm(rotation_vector(X_SF[0, :3, :3].T @ X[:3, :3]))) for X in X_SF)
    if shift > MOST_SHIFT or turn > MOST_TURN:
        raise evidence.Refused(
            "bases",
            [
                f"endoscope: moved by {1e3 * shift:.1f} mm and {np.degrees(turn):.1f} deg between "
                f"the rests; at most {1e3 * MOST_SHIFT:g} mm, {np.degrees(MOST_TURN):g} deg: move "
                "the instrument only"
            ],
        )


def _pair(views: Views, view: View) -> tuple[Picture, Picture]:
    """Both pictures (h, w, 3) of a view."""
    found = []
    for eye in EYES:
        file = views.folder / f"{view.name}_{eye}.png"
        picture = cv2.imread(str(file), cv2.IMREAD_COLOR)
        if picture is None:
            raise ViewsError(f"{file}: is missing; bases by tip need both eyes")
        found.append(np.asarray(picture, dtype=np.uint8))
    return found[0], found[1]


def enough_tips(used: Sequence[View], left_out: Sequence[str]) -> None:
    """Refuse too few rests, with the reasons of those that were left out.

    Raises:
        Refused: There are fewer than needed.
    """
    if len(used) < evidence.LEAST_RESTS:
        why = f" ({left_out[0]})" if left_out else ""
        raise evidence.Refused(
            "bases", [f"rests: {len(used)}; at least {evidence.LEAST_RESTS}: take more{why}"]
        )
