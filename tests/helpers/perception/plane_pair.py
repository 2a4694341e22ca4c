"""A speckled plane before two real eyes: pictures by ray tracing, and the depth that is true.

It shares no code with what finds depth: `board_bench.py` traces the rays.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

import surg_core
from helpers.sim.board_bench import BoardPainter, Pattern
from surg_core.lens_file import Lens
from surg_sim.appearance.lens import EndoscopeLens, TrueEye

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

FOVY = np.radians(56.0)
APART = 3.0
"""[px] The right rectified eye's principal point lies this far to the left of the left one's."""


def speckles(rng: np.random.Generator, side: int = 900) -> Picture:
    """A grey pattern with detail of several sizes."""
    picture = np.zeros((side, side))
    for size, weight in ((6, 1.0), (18, 1.0), (60, 0.7)):
        small = rng.normal(size=(side // size + 2, side // size + 2)).astype(np.float32)
        picture += weight * cv2.resize(small, (side, side), interpolation=cv2.INTER_CUBIC)
    spread = (picture - picture.mean()) / picture.std()
    return np.clip(130 + 45 * spread, 30, 235).astype(np.uint8)


@dataclass
class PlanePair:
    """A plane at a distance, and two eyes that are not quite parallel.

    Attributes:
        lens: Of both eyes.
        distance: Of the plane's middle [m].
        size: Of the pictures [px].
        tilt: Of the plane about the picture's y axis [rad].
        toe: The right eye looks this much to the left [rad].
        baseline: Length of the way from the left to the right eye [m].
        seed: Of pattern and noise.
    """

    lens: EndoscopeLens = field(default_factory=EndoscopeLens)
    distance: float = 0.08
    size: tuple[int, int] = (320, 240)
    tilt: float = 0.3
    toe: float = 0.01
    baseline: float = 0.004
    seed: int = 0

    def __post_init__(self) -> None:
        """Place everything."""
        self.rng = np.random.default_rng(self.seed)
        self.eye = TrueEye.of(float(FOVY), *self.size, self.lens)
        along = np.array([1.0, 0.02, -0.03])
        self.X_LR = np.eye(4)
        self.X_LR[:3, :3] = surg_core.axis_angle_to_matrix(np.array([0.0, -1.0, 0.1]), self.toe)
        self.X_LR[:3, 3] = self.baseline * along / np.linalg.norm(along)
        half = 2.2 * self.distance
        face = np.diag([1.0, -1.0, -1.0])
        R = surg_core.axis_angle_to_matrix(np.array([0.0, 1.0, 0.0]), self.tilt) @ face
        self.X_LBoard = np.eye(4)
        self.X_LBoard[:3, :3] = R
        self.X_LBoard[:3, 3] = [0.0, 0.0, self.distance] - R @ [half / 2, half / 2, 0.0]
        self.pattern = Pattern(speckles(self.rng), (half, half))

    @property
    def R_rect(self) -> Array:
        """(3, 3) from the left eye's axes to those of the rectified eyes, by hand."""
        x = self.X_LR[:3, 3] / np.linalg.norm(self.X_LR[:3, 3])
        y = np.cross([0.0, 0.0, 1.0], x)
        y /= np.linalg.norm(y)
        return np.array([x, y, np.cross(x, y)])

    def lenses(self) -> tuple[Lens, Lens]:
        """The true lens files."""
        (width, height), K, R = self.size, self.eye.K, self.R_rect
        D = np.array(self.lens.distortion)
        made = []
        for side, turn, b in (
            ("left", R, 0.0),
            ("right", R @ self.X_LR[:3, :3], self.baseline),
        ):
            P = np.zeros((3, 4))
            P[:, :3] = self.straight
            P[0, 3] = -P[0, 0] * b
            P[0, 2] -= APART if b else 0.0
            name = f"endoscope_{side}"
            made.append(Lens(width, height, name, K, "plumb_bob", D, turn, P))
        return made[0], made[1]

    @property
    def straight(self) -> Array:
        """Camera matrix (3, 3) of the rectified eyes."""
        f, (width, height) = self.eye.f, self.size
        return np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]])

    def pictures(self) -> tuple[Picture, Picture]:
        """What both eyes see, (h, w, 3), with noise of two grey levels."""
        painter = BoardPainter(self.pattern, self.eye)
        seen = []
        for X in (self.X_LBoard, surg_core.inverse_pose(self.X_LR) @ self.X_LBoard):
            seen.append(np.repeat(painter.draw(X, self.rng)[..., None], 3, axis=2))
        return seen[0], seen[1]

    def depth(self) -> Array:
        """True depth (h, w) in the rectified left eye [m]."""
        (width, height), K = self.size, self.straight
        y, x = np.mgrid[:height, :width]
        rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1)
        normal = self.R_rect @ self.X_LBoard[:3, 2]
        place = self.R_rect @ self.X_LBoard[:3, 3]
        return np.asarray((normal @ place) / (rays @ normal))
