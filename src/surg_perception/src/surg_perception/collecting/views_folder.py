"""Writes a folder of views, one view after the other; `views` reads it."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import cv2

from surg_core.transforms import FloatArray
from surg_perception.calibration.board import Board, Picture
from surg_perception.calibration.board_file import write_board
from surg_perception.calibration.views import EYES


class ViewsFolder:
    """A new folder of views.

    Args:
        path: The folder; it is made.
        board: What the views show.
        joints: Columns of the joints, such as ``ECM/elbow_joint``.

    Raises:
        OSError: It cannot be made, or has views already.
    """

    def __init__(self, path: Path, board: Board, joints: Sequence[str] = ()) -> None:
        self.path, self._joints = path, tuple(joints)
        self._rows: list[list[str]] = []
        self._number = 0
        path.mkdir(parents=True, exist_ok=True)
        if (path / "views.csv").exists():
            raise FileExistsError(f"{path}: has views already; name another folder")
        write_board(path / "board.yaml", board)

    def add(
        self,
        stamp: float,
        pair: tuple[Picture, ...],
        q: FloatArray | None,
        touch: int | None = None,
    ) -> str:
        """Write a view; returns its name.

        Args:
            stamp: Of the exposure [s].
            pair: Left and right picture (h, w), grey; the left one alone of a single eye.
            q: Joint positions (n,) in the order of the columns [rad].
            touch: Corner that an instrument touches; None: none.

        Raises:
            OSError: A file cannot be written.
        """
        name = f"{self._number:03d}"
        for eye, picture in zip(EYES, pair, strict=False):
            file = self.path / f"{name}_{eye}.png"
            if not cv2.imwrite(str(file), picture):
                raise OSError(f"{file}: cannot be written")
        values = [] if q is None else [f"{value:.9f}" for value in q]
        if len(values) != len(self._joints):
            raise ValueError(f"{len(values)} joints; the folder has {len(self._joints)} columns")
        self._number += 1
        self._rows.append([name, f"{stamp:.9f}", "" if touch is None else str(touch), *values])
        self._write()
        return name

    def undo(self) -> None:
        """Delete the last view."""
        name = self._rows.pop()[0]
        self._write()
        for eye in EYES:
            (self.path / f"{name}_{eye}.png").unlink(missing_ok=True)

    def _write(self) -> None:
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(["view", "stamp", "touch", *self._joints])
        rows.writerows(self._rows)
        (self.path / "views.csv").write_text(text.getvalue(), encoding="utf-8")
