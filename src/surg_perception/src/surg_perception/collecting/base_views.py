"""Views for the base of a second arm: one each time that a person says so. No ROS.

By touch the person brings the tip to the corner that is asked for, by tip to any new place. Only a
person can see that the tip is where it should be, so no view is taken by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import surg_core
from surg_core.transforms import FloatArray
from surg_perception.calibration import base_steps, chain_steps, evidence, steps
from surg_perception.calibration.board import Picture
from surg_perception.calibration.result_files import Origin, read_eyes
from surg_perception.calibration.small_motions import transform
from surg_perception.calibration.views import View
from surg_perception.collecting.board_detection import blur_in_words, is_sharp, look_at, rough_lens
from surg_perception.collecting.views_folder import ViewsFolder

WANTED = {"touch": 32, "tip": 12}
"""Views at which the base is solved for: eight places of the board with four corners each."""
AGAIN = {"touch": 8, "tip": 4}
"""Further views after a refusal."""
ENDS = ("upper left", "upper right", "lower left", "lower right")
NEW_PLACE = {"touch": 0.002, "tip": 0.008}
"""[m] Of the tip from the last view, and by tip from every earlier one."""
WRONG_CORNER = 0.012
"""[m] Farther from where the earlier touches put a corner, it is another one: the outer corners lie
30 mm apart and more. A base 5 degrees off moves places 0.1 m apart by 9 mm against each other."""


@dataclass(frozen=True)
class Moment:
    """What the running system shows.

    Attributes:
        stamp: Of the exposure [s].
        pair: Left and right picture (h, w), grey; the left one alone of a single eye.
        joints: Of each arm, mean positions (n,) of its rest at the exposure [rad]; None: it moves.
    """

    stamp: float
    pair: tuple[Picture, ...]
    joints: Mapping[str, FloatArray | None]


class BaseViews:
    """Takes the views of one base and solves for it.

    Args:
        cell: With a calibrated endoscope.
        by: ``touch`` or ``tip``.
        path: A new folder for the views.

    Attributes:
        arms: Names of the endoscope's and of the instrument's arm.
        eyes: That the cell has, 1 or 2.
        count: Views that are there.
        wanted: Views at which it is solved.

    Raises:
        ValueError: The cell lacks what the step needs.
        OSError: The folder cannot be made, or has views already.
    """

    def __init__(self, cell: surg_core.Cell, by: str, path: Path) -> None:
        calibration = cell.folder / "calibration"
        camera, _ = chain_steps.measured_camera(cell)
        assert camera.X_FV is not None
        self._cell, self._by, self.path = cell, by, path
        self._X_FV = np.array(camera.X_FV)
        self._scope, self._tool = steps.scope_arm(cell), chain_steps.tool_arm(cell)
        self._eyes, two = read_eyes(calibration)
        self.eyes = 1 if two is None else 2
        if by == "tip" and two is None:
            raise evidence.Refused("bases", ["eyes: 1; by tip needs 2: use --by touch"])
        self._board = steps.find_board(calibration, path)
        across, n = self._board.columns - 1, len(self._board.corners)
        self._ends = (0, across - 1, n - across, n - 1)
        self.arms = (self._scope.name, self._tool.name)
        self._columns = [
            f"{arm.name}/{joint}"
            for arm in (self._scope, self._tool)
            for joint in arm.robot.joint_names
        ]
        self._folder = ViewsFolder(path, self._board, self._columns)
        self.wanted = WANTED[by]
        self._tips: list[FloatArray] = []  # in the instrument arm's base
        self._apart: list[FloatArray] = []  # from the tip by joints to the corner seen, in W

    @property
    def count(self) -> int:
        """Views that are there."""
        return len(self._tips)

    @property
    def request(self) -> str:
        """What the person does next."""
        if self._by == "tip":
            return "Bring the tip to a new place in the view, also nearer or farther, and rest."
        place, end = divmod(self.count, len(ENDS))
        move = "Move the board, also nearer or farther. " if place and not end else ""
        return f"{move}Touch the {ENDS[end]} inner corner (number {self._ends[end]}) and rest."

    def take(self, moment: Moment) -> str:
        """Take a view, or state why not; empty: it was taken.

        Raises:
            OSError: It cannot be stored.
        """
        for arm in self.arms:
            if moment.joints.get(arm) is None:
                return f"{arm} moves: let both arms rest for half a second"
        size = (moment.pair[0].shape[1], moment.pair[0].shape[0])
        if size != self._eyes.left.size:
            wide, high = self._eyes.left.size
            return f"pictures of {size[0]} x {size[1]} px; the lens files are for {wide} x {high}"
        q = np.concatenate([np.asarray(moment.joints[arm]) for arm in self.arms])
        joints = dict(zip(self._columns, q, strict=True))
        touch = self._ends[self.count % len(ENDS)] if self._by == "touch" else None
        view = View("", moment.stamp, joints, touch, (None, None))
        p_T = base_steps.tips(self._tool, [view])[0]
        earlier = self._tips[-1:] if self._by == "touch" else self._tips
        if any(np.linalg.norm(p_T - other) < NEW_PLACE[self._by] for other in earlier):
            return "the tip has not moved: bring it to the next place"
        apart = np.zeros(3)
        if touch is not None:
            seen = self._touched(moment, view)
            if isinstance(seen, str):
                return seen
            apart = seen - transform(self._tool.X_WB, p_T[None])[0]
            if why := self._other_corner(apart, touch):
                return why
        self._folder.add(moment.stamp, moment.pair, q, touch)
        self._tips.append(p_T)
        self._apart.append(apart)
        return ""

    def undo(self) -> bool:
        """Delete the last view; False: there is none."""
        if not self._tips:
            return False
        self._tips.pop()
        self._apart.pop()
        self._folder.undo()
        return True

    def solve(self, origin: Origin, write: bool) -> tuple[bool, Sequence[str]]:
        """Solve for the base: whether it is accepted, and lines for people."""
        try:
            return True, base_steps.bases(self._cell, self.path, self._by, origin, write)[2]
        except evidence.Refused as refused:
            reasons: Sequence[str] = refused.reasons
        except (ValueError, OSError, np.linalg.LinAlgError) as error:
            reasons = [str(error)]
        self.wanted = max(self.wanted, self.count) + AGAIN[self._by]
        return False, reasons

    def _touched(self, moment: Moment, view: View) -> FloatArray | str:
        """The touched corner (3,) in the world as the scope sees it; a text: it does not."""
        lens = rough_lens(self._eyes.left.size, self._eyes.left.K)
        look = look_at(self._board, moment.pair, lens, moment.stamp)
        if isinstance(look, str):
            return f"{look}: show more of the board"
        if not is_sharp(look):
            return f"the picture is blurred ({blur_in_words(look)}): focus, or change the distance"
        left, right = (*look.corners, None)[:2]
        seen = replace(view, corners=(left, right))
        X_WV = self._scope.X_WB @ base_steps.postures(self._scope, [view]) @ self._X_FV
        return base_steps.touched_corners(X_WV, self._eyes, [seen], self._board, self.eyes)[0]

    def _other_corner(self, apart: FloatArray, touch: int) -> str:
        """Why this is not the corner that was asked for; empty: it may be."""
        if not self._apart:
            return ""
        off = float(np.linalg.norm(apart - np.median(self._apart, axis=0)))
        if off <= WRONG_CORNER:
            return ""
        return (
            f"the tip is {1e3 * off:.0f} mm from where the earlier touches put corner {touch}: "
            "touch that corner, or delete the last view (u) if it was another one"
        )
