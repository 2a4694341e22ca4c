"""One look at the board: its corners in the eyes, how sharp they are, where board and scope were.

Pure functions judge a look: `is_new`, `is_sharp`, `is_still`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surg_core.pictures.lens_model import LensModel
from surg_core.transforms import FloatArray, rotation_vector
from surg_perception.calibration.board import Board, Corners, Picture
from surg_perception.calibration.intrinsics import SeenCorners, board_pose

FOCAL_SHARE = 0.8
"""Assumed focal length over the width of the picture, while no lens is known."""
MOST_BLUR = 0.06
"""Largest blur of an edge, one sigma, as a share of a square's side; see `edge_blur`."""
STILL_S = 0.3
"""[s] Time for which the board must stay in its place."""
MOST_MOTION = 0.04
"""Largest motion of a corner in that time as a share of a square's side: 0.2 mm of 5 mm."""
NEW_SHIFT, NEW_DISTANCE, NEW_TURN = 0.1, 0.15, math.radians(10.0)
"""A new place of the board: as a share of its distance, both of them, or turned by so much."""
NEW_PLACE, NEW_POSTURE = 0.008, math.radians(5.0)
"""[m], [rad] A new posture of the arm that holds the endoscope."""
_EDGE = math.sqrt(2.0 * math.pi)


@dataclass(frozen=True)
class BoardDetection:
    """What one pair of pictures shows.

    Attributes:
        stamp: Of the exposure [s].
        corners: In the left and in the right picture, or in that of the only eye.
        blur: Of the edges, the worst of the eyes, as a share of a square's side.
        side: Of a square in the left picture [px].
        X_VBoard: Pose (4, 4) of the board's middle before the left eye, by a roughly known lens.
        X_BF: Flange (4, 4) of the arm that holds the scope; None: it moves, or is not needed.
        q: ``(n,)`` its joint positions, mean of the rest [rad]; None as ``X_BF``.
    """

    stamp: float
    corners: tuple[Corners, ...]
    blur: float
    side: float
    X_VBoard: FloatArray
    X_BF: FloatArray | None = None
    q: FloatArray | None = None

    @property
    def distance(self) -> float:
        """From the left eye to the middle of the board [m], roughly."""
        return float(self.X_VBoard[2, 3])

    @property
    def lean(self) -> FloatArray:
        """Lean (2,) of the board [rad]: about the picture's x axis and about its y axis."""
        n = -self.X_VBoard[:3, 2]  # into the board: along the view when the board faces the eye
        return np.arctan2([n[1], n[0]], n[2])


def rough_lens(size: tuple[int, int], K: FloatArray | None = None) -> LensModel:
    """A pinhole for a first idea of distances: K (3, 3) where one is known."""
    f = FOCAL_SHARE * size[0]
    values = np.array([f, f, (size[0] - 1) / 2, (size[1] - 1) / 2])
    if K is not None and K[0, 0] > 0.0:
        values = K[[0, 1, 0, 1], [0, 1, 2, 2]]
    return LensModel("plumb_bob", size, np.concatenate([values, np.zeros(5)]))


def look_at(
    board: Board, pair: tuple[Picture, ...], lens: LensModel, stamp: float
) -> BoardDetection | str:
    """Find the board in the pictures (h, w), grey, of the eyes; a text: why it is not seen."""
    found = []
    for picture, eye in zip(pair, ("left", "right"), strict=False):
        corners = board.find(picture)
        if corners is None:
            return f"the {eye} eye does not see the board"
        found.append(corners)
    sides = [board.side_in(corners) for corners in found]
    if min(sides) <= 0.0:
        return "the corners that are seen are not neighbours; show more of the board"
    blur = max(
        edge_blur(picture, corners.pixels, side) / side
        for picture, corners, side in zip(pair, found, sides, strict=True)
    )
    left = SeenCorners(board.corners[found[0].ids], found[0].pixels)
    try:
        X = centred(board_pose(lens, left), board)
    except ValueError as error:
        return str(error)
    return BoardDetection(stamp, tuple(found), blur, sides[0], X)


def centred(X_VBoard: FloatArray, board: Board) -> FloatArray:
    """The pose (4, 4) with its origin in the middle of the board."""
    X = X_VBoard.copy()
    X[:3, 3] = X[:3, :3] @ board.corners.mean(axis=0) + X[:3, 3]
    return X


def edge_blur(picture: Picture, pixels: FloatArray, side: float) -> float:
    """Blur of the edges around corners, one sigma of a Gaussian, median over the corners [px].

    A step of height h, blurred by sigma, is at most h / (sqrt(2 pi) sigma) steep. An edge as sharp
    as a pixel reads 0.9, blurs from 1 to 3 px are right within 0.3 px.

    Args:
        picture: (h, w), grey.
        pixels: (n, 2) of the corners.
        side: Of a square [px].
    """
    height, width = picture.shape
    near, wide = max(3, round(0.3 * side)), max(4, round(0.9 * side))
    found = []
    for x, y in np.round(pixels).astype(int):
        if not (wide < x < width - wide - 1 and wide < y < height - wide - 1):
            continue
        # Black and white are those of whole squares: a blurred edge has none of its own.
        square = picture[y - wide : y + wide + 1, x - wide : x + wide + 1]
        low, high = np.percentile(square, [2, 98])
        patch = picture[y - near : y + near + 1, x - near : x + near + 1].astype(np.float64)
        steep = np.hypot(
            (patch[1:-1, 2:] - patch[1:-1, :-2]) / 2.0, (patch[2:, 1:-1] - patch[:-2, 1:-1]) / 2.0
        )
        found.append((high - low) / (_EDGE * max(float(np.percentile(steep, 95)), 1e-6)))
    return float(np.median(found)) if found else math.inf


def is_still(looks: Sequence[BoardDetection]) -> bool:
    """Whether the board has kept its place over the last `STILL_S` of looks, oldest first."""
    if not looks:
        return False
    newest = looks[-1]
    window = [look for look in looks if newest.stamp - look.stamp <= STILL_S + 1e-9]
    before = [look for look in looks if newest.stamp - look.stamp >= STILL_S - 1e-9]
    if not before:
        return False
    return all(
        motion(look, newest) <= MOST_MOTION * newest.side for look in (before[-1], *window[:-1])
    )


def motion(a: BoardDetection, b: BoardDetection) -> float:
    """Median motion of the corners that both looks show in the left picture [px]."""
    ids = np.intersect1d(a.corners[0].ids, b.corners[0].ids)
    if not len(ids):
        return math.inf
    moved = a.corners[0].only(ids).pixels - b.corners[0].only(ids).pixels
    return float(np.median(np.linalg.norm(moved, axis=1)))


def is_sharp(look: BoardDetection) -> bool:
    """Whether the edges are sharp enough for corners of a tenth of a pixel."""
    return look.blur <= MOST_BLUR


def blur_in_words(look: BoardDetection) -> str:
    """How blurred a look is, and how much is allowed."""
    return f"{look.blur * look.side:.1f} px; at most {MOST_BLUR * look.side:.1f}"


def is_new(look: BoardDetection, views: Sequence[BoardDetection], by_posture: bool = False) -> bool:
    """Whether a look differs from every view: by the board's place, or by the arm's posture."""
    differs = posture_differs if by_posture else board_differs
    return all(differs(look, view) for view in views)


def board_differs(a: BoardDetection, b: BoardDetection) -> bool:
    """Whether the board was held elsewhere before the eye."""
    apart = a.X_VBoard[:2, 3] / a.distance - b.X_VBoard[:2, 3] / b.distance
    turned = rotation_vector(a.X_VBoard[:3, :3] @ b.X_VBoard[:3, :3].T)
    return bool(
        np.linalg.norm(apart) >= NEW_SHIFT
        or abs(math.log(a.distance / b.distance)) >= NEW_DISTANCE
        or np.linalg.norm(turned) >= NEW_TURN
    )


def posture_differs(a: BoardDetection, b: BoardDetection) -> bool:
    """Whether the arm that holds the scope was in another posture."""
    if a.X_BF is None or b.X_BF is None:
        return False
    turned = rotation_vector(a.X_BF[:3, :3] @ b.X_BF[:3, :3].T)
    apart = np.linalg.norm(a.X_BF[:3, 3] - b.X_BF[:3, 3])
    return bool(np.linalg.norm(turned) >= NEW_POSTURE or apart >= NEW_PLACE)
