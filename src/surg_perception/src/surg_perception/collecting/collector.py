"""Which views of the board a calibration still needs, and whether a look at it becomes one.

A look is taken when it is new, sharp and still and when it adds something that is missing. No ROS,
no clock and no files: looks in, answers out.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from surg_core.transforms import FloatArray
from surg_perception.calibration import evidence
from surg_perception.calibration.board import Board
from surg_perception.calibration.handeye import turns_between
from surg_perception.calibration.intrinsics import SeenCorners
from surg_perception.collecting.board_detection import (
    STILL_S,
    BoardDetection,
    blur_in_words,
    is_new,
    is_sharp,
    is_still,
)

COLUMNS, ROWS = 5, 4
"""Fields of the picture."""
WANTED_STEREO, WANTED_HANDEYE = 20, 15
"""Views at which a step is solved."""
AGAIN = 4
"""Further views after a solution was refused."""
NEAR, FAR = 0.07, 0.09
"""[m] Between a near, a middle and a far board."""
FACING = math.radians(12.0)
"""Less lean is a board that faces the eye."""
LEAST_EACH = 3
"""Views at each distance and with each tilt."""
WANTED_TURN = evidence.LEAST_TURN + math.radians(5.0)
"""[rad] Of the flange between two postures, about each of two axes."""
WANTED_COVERAGE = evidence.LEAST_COVERAGE + 0.02

DISTANCES = ("nearer than 70 mm", "70 to 90 mm away", "farther than 90 mm")
TILTS = ("facing the lens", "tilted forwards or backwards", "tilted to the left or right")
QUARTERS = ("upper left", "upper right", "lower left", "lower right")


class CalibrationStep(Enum):
    """What the views are for."""

    STEREO = "stereo"
    HANDEYE = "handeye"


def fields(pixels: FloatArray, size: tuple[int, int]) -> NDArray[np.int64]:
    """The fields (k,) in which pixels (n, 2) lie, numbered row by row from the upper left."""
    share = (pixels + 0.5) / np.array(size)
    column, row = np.clip((share * [COLUMNS, ROWS]).astype(int), 0, [COLUMNS - 1, ROWS - 1]).T
    return np.unique(row * COLUMNS + column)


def needed_fields(size: tuple[int, int]) -> NDArray[np.bool_]:
    """Fields (20,) that reach into the circle that must be covered: not the dark corners."""
    width, height = size
    needed = []
    for number in range(COLUMNS * ROWS):
        row, column = divmod(number, COLUMNS)
        x = np.clip(width / 2, column * width / COLUMNS, (column + 1) * width / COLUMNS)
        y = np.clip(height / 2, row * height / ROWS, (row + 1) * height / ROWS)
        out = math.hypot(x - width / 2, y - height / 2) / (min(size) / 2)
        needed.append(out < evidence.LEAST_COVERAGE)
    return np.array(needed)


def distance_band(look: BoardDetection) -> int:
    """Index into `DISTANCES`."""
    return int(look.distance >= NEAR) + int(look.distance >= FAR)


def tilt_band(look: BoardDetection) -> int:
    """Index into `TILTS`."""
    about_x, about_y = np.abs(look.lean)
    if math.hypot(about_x, about_y) < FACING:
        return 0
    return 1 if about_x > about_y else 2


class Collector:
    """Takes looks for one step.

    Args:
        step: What the views are for.
        board: What they show.
        size: Width and height of the pictures [px].

    Attributes:
        taken: The looks that became views.
        wanted: Views at which the step can be solved.
        missing: What the step still needs, in words, the most useful first.
        progress: Share of what the step needs, 0 to 1.
        fields: ``(20,)`` views that show the board in each field of the left picture.
    """

    def __init__(self, step: CalibrationStep, board: Board, size: tuple[int, int]) -> None:
        self.step, self.board, self.size = step, board, size
        self.taken: list[BoardDetection] = []
        self.wanted = WANTED_STEREO if step is CalibrationStep.STEREO else WANTED_HANDEYE
        self._recent: deque[BoardDetection] = deque()
        self._count()

    def offer(self, look: BoardDetection) -> str:
        """Take a look, or state why not; empty: it was taken."""
        self._recent.append(look)
        while not 0.0 <= look.stamp - self._recent[0].stamp <= 3 * STILL_S:
            self._recent.popleft()
        why = self._why_not(look)
        if not why:
            self.taken.append(look)
            self._count()
        return why

    def lose(self) -> None:
        """The board is out of sight: the time of standing still begins anew."""
        self._recent.clear()

    def undo(self) -> bool:
        """Forget the last view; False: there is none."""
        if not self.taken:
            return False
        self.taken.pop()
        self._count()
        return True

    def more(self) -> None:
        """A solution was refused: further views are needed."""
        self.wanted = max(self.wanted, len(self.taken)) + AGAIN
        self._count()

    @property
    def complete(self) -> bool:
        """Whether nothing is missing."""
        return not self.missing

    def _count(self) -> None:
        """Count anew what is there."""
        needs = self._needs(self.taken)
        self.fields = seen_fields(self.taken, self.size)
        self.missing = [text for share, text in needs if share < 1.0]
        self.progress = float(np.mean([share for share, _ in needs]))

    def _needs(self, taken: Sequence[BoardDetection]) -> list[tuple[float, str]]:
        """Each need: how far it is met, and in words."""
        needs = (
            stereo_needs(taken, self.board, self.size)
            if self.step is CalibrationStep.STEREO
            else handeye_needs(taken)
        )
        n = self.wanted - len(taken)
        text = f"{n} more view{'s' if n > 1 else ''}"
        return [*needs, (min(1.0, len(taken) / self.wanted), text)]

    def _why_not(self, look: BoardDetection) -> str:
        """Why a look is no view; empty: it is one."""
        if not is_sharp(look):
            return f"The picture is blurred ({blur_in_words(look)}). Focus, or change the distance."
        if self.step is CalibrationStep.HANDEYE and look.X_BF is None:
            return "Hold the endoscope still."
        still_needed = f"Still needed: {next(iter(self.missing), 'nothing')}."
        if not is_new(look, self.taken, self.step is CalibrationStep.HANDEYE):
            return f"This view is there already. {still_needed}"
        if not self._adds(look):
            return f"This view adds nothing. {still_needed}"
        if not is_still(tuple(self._recent)):
            what = "board" if self.step is CalibrationStep.STEREO else "endoscope"
            return f"Good place. Hold the {what} still."
        return ""

    def _adds(self, look: BoardDetection) -> bool:
        """Whether a look brings the step on."""
        if len(self.taken) < self.wanted:
            return True
        with_it = np.mean([share for share, _ in self._needs([*self.taken, look])])
        return bool(with_it > self.progress + 1e-9)


def seen_fields(taken: Sequence[BoardDetection], size: tuple[int, int]) -> NDArray[np.int64]:
    """Views that show the board in each field of the left picture (20,)."""
    count = np.zeros(COLUMNS * ROWS, dtype=np.int64)
    for look in taken:
        count[fields(look.corners[0].pixels, size)] += 1
    return count


def stereo_needs(
    taken: Sequence[BoardDetection], board: Board, size: tuple[int, int]
) -> list[tuple[float, str]]:
    """Needs of the lenses: the picture covered, each distance and each tilt."""
    needed = needed_fields(size)
    empty = np.flatnonzero(needed & (seen_fields(taken, size) == 0))
    where = _place(int(empty[0])) if len(empty) else ""
    needs = [(1.0 - len(empty) / needed.sum(), f"the board in the {where} of the picture")]
    eyes = len(taken[0].corners) if taken else 1
    for eye, name in enumerate(("left", "right")[:eyes]):
        reached = np.zeros(4)
        if taken:
            corners = [look.corners[eye] for look in taken]
            reached = evidence.coverage(
                [SeenCorners(board.corners[c.ids], c.pixels) for c in corners], size
            )
        worst = QUARTERS[int(reached.argmin())]
        share = min(1.0, float(reached.min()) / WANTED_COVERAGE)
        needs.append((share, f"the board farther out in the {worst} of the {name} picture"))
    for band, names in ((distance_band, DISTANCES), (tilt_band, TILTS)):
        bands = [band(look) for look in taken]
        for number, each in enumerate(names):
            n = bands.count(number)
            text = f"a board {each} ({n} of {LEAST_EACH} views)"
            needs.append((min(1.0, n / LEAST_EACH), text))
    return needs


def handeye_needs(taken: Sequence[BoardDetection]) -> list[tuple[float, str]]:
    """Needs of the hand-eye pose: turns about two axes."""
    poses = [look.X_BF for look in taken if look.X_BF is not None]
    turns = turns_between(np.array(poses)) if len(poses) > 2 else np.zeros(2)
    largest, across = (
        f"{math.degrees(t):.0f} of {math.degrees(WANTED_TURN):.0f} deg" for t in turns
    )
    texts = (
        f"a larger turn of the endoscope ({largest})",
        f"a turn about another axis ({across}): roll the endoscope, or tilt it the other way",
    )
    return [(min(1.0, float(t) / WANTED_TURN), text) for t, text in zip(turns, texts, strict=True)]


def hint(missing: Sequence[str]) -> str:
    """What to do next when a view was taken."""
    return f"View taken. Next: {missing[0]}." if missing else "Everything is there."


def _place(field: int) -> str:
    """Where a field lies, in words."""
    row, column = divmod(field, COLUMNS)
    down = ("top", "upper half", "lower half", "bottom")[row]
    side = ("far left", "left", "middle", "right", "far right")[column]
    return f"{down}, {side}"
