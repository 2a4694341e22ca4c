"""One calibration from a running system: takes views, solves, states what is missing. No ROS."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

import surg_core
from surg_core.transforms import FloatArray
from surg_perception.calibration import steps
from surg_perception.calibration.board import Board, Picture
from surg_perception.calibration.result_files import Origin, check_one_eye, read_eyes
from surg_perception.collecting import collector
from surg_perception.collecting.board_detection import look_at, rough_lens
from surg_perception.collecting.collector import CalibrationStep, Collector
from surg_perception.collecting.views_folder import ViewsFolder


class CalibrationState(Enum):
    """What is going on; the names are those of surg_msgs/CalibrationStatus."""

    IDLE = "idle"
    COLLECTING = "collecting"
    SOLVING = "solving"
    DONE = "done"


@dataclass(frozen=True)
class Status:
    """What people and pages see; see surg_msgs/CalibrationStatus."""

    state: CalibrationState = CalibrationState.IDLE
    step: CalibrationStep | None = None
    views: int = 0
    wanted: int = 0
    progress: float = 0.0
    hint: str = ""
    missing: tuple[str, ...] = ()
    fields: tuple[int, ...] = ()
    needed: tuple[bool, ...] = ()
    corners: tuple[float, ...] = ()
    residual: float = math.nan
    result: tuple[str, ...] = ()
    folder: str = ""


@dataclass
class LiveCalibration:
    """Collects the views of a step and solves it.

    Args:
        cell: Whose endoscope is calibrated.
        new_folder: Gives a new folder for the views of a step.
        origin: Of the files that a step writes.
        lens_state: Focus and zoom in words.
        write: Whether the files are written.
        left_only: Measure the left lens alone, as that of an endoscope of one eye.

    Attributes:
        eyes: Of the endoscope that the present step looks at, 1 or 2.
        status: Read it from any thread.
    """

    cell: surg_core.Cell
    new_folder: Callable[[CalibrationStep], Path]
    origin: Callable[[CalibrationStep, Path], Origin]
    lens_state: str = ""
    write: bool = True
    left_only: bool = False
    eyes: int = field(default=2, init=False)
    status: Status = field(default=Status(hint="Choose a step."), init=False)

    def __post_init__(self) -> None:
        """Nothing is collected yet."""
        self._lock = threading.Lock()
        self._collector: Collector | None = None
        self._folder: ViewsFolder | None = None
        self._board: Board | None = None
        self._K: FloatArray | None = None
        self._asked = False

    @property
    def arm(self) -> surg_core.Arm | None:
        """The arm whose joints the views hold; None: they hold none."""
        return steps.scope_arm(self.cell) if self.status.step is CalibrationStep.HANDEYE else None

    def start(self, step: CalibrationStep) -> None:
        """Begin a step with a new folder.

        Raises:
            ValueError: The cell lacks what the step needs.
            OSError: The folder cannot be made.
        """
        with self._lock:
            calibration = self.cell.folder / "calibration"
            arm, joints = steps.scope_arm(self.cell), list[str]()
            self.eyes = eyes = self._eyes_of(step, arm, calibration)
            folder = self.new_folder(step)
            board = steps.find_board(calibration, folder)
            if step is CalibrationStep.HANDEYE:
                joints = [f"{arm.name}/{joint}" for joint in arm.robot.joint_names]
            self._folder, self._board = ViewsFolder(folder, board, joints), board
            self._collector, self._asked = None, False
            hint = f"Waiting for pictures of {'both eyes' if eyes > 1 else 'the eye'}."
            self.status = Status(CalibrationState.COLLECTING, step, hint=hint, folder=str(folder))

    def _eyes_of(self, step: CalibrationStep, arm: surg_core.Arm, calibration: Path) -> int:
        """How many eyes a step looks at: what was measured before, or what the instrument has."""
        if step is CalibrationStep.HANDEYE:
            return 1 if read_eyes(calibration)[1] is None else 2
        camera = arm.instrument.camera
        assert camera is not None
        eyes = 1 if self.left_only else len(camera.frames)
        if eyes == 1:
            check_one_eye(calibration)
        return eyes

    def lens(self, K: FloatArray) -> None:
        """The camera matrix (3, 3) of the running system, for a first idea of distances."""
        self._K = K

    def undo(self) -> None:
        """Delete the last view."""
        with self._lock:
            if not self._collecting or self._collector is None:
                self._publish(hint="There is no view to delete.")
            elif self._collector.undo():
                assert self._folder is not None
                self._folder.undo()
                self._publish(hint="The last view is deleted.")

    def ask_to_solve(self) -> None:
        """Solve with the views so far, at the next opportunity of `step_on`."""
        with self._lock:
            self._asked = self._collecting

    def refuse(self, why: str) -> None:
        """State why a step was not started."""
        with self._lock:
            self._publish(result=(why,), hint=f"Not started: {why}.")

    def say(self, hint: str) -> None:
        """State what is wrong with the running system."""
        with self._lock:
            if self._collecting:
                self._publish(hint=hint, corners=())

    def see(
        self,
        stamp: float,
        pair: tuple[Picture, ...],
        q: FloatArray | None = None,
    ) -> None:
        """Look at a pair of pictures, and take it if it is a view.

        Args:
            stamp: Of the exposure [s].
            pair: Left and right picture (h, w), grey; the left one alone where `eyes` is 1.
            q: Joint positions (n,) of `arm` in rest at the exposure [rad]; None: it moves.
        """
        with self._lock:
            if not self._collecting or self._folder is None:
                return
            size = (pair[0].shape[1], pair[0].shape[0])
            if self._collector is None:
                assert self.status.step is not None and self._board is not None
                self._collector = Collector(self.status.step, self._board, size)
            hint = self._judge(self._collector, self._folder, stamp, pair, q)
            self._publish(hint=hint)

    def _judge(
        self,
        collecting: Collector,
        folder: ViewsFolder,
        stamp: float,
        pair: tuple[Picture, ...],
        q: FloatArray | None,
    ) -> str:
        """Offer a pair to the collector; returns what to tell the person."""
        size = collecting.size
        if any((p.shape[1], p.shape[0]) != size for p in pair):
            return "The pictures have changed their size. Start the step again."
        look = look_at(collecting.board, pair, rough_lens(size, self._K), stamp)
        if isinstance(look, str):
            collecting.lose()
            self._publish(corners=())
            return f"Show the board: {look}."
        share = (look.corners[0].pixels + 0.5) / np.array(size)
        self._publish(corners=tuple(share.ravel().tolist()))
        arm = self.arm
        if arm is not None and q is not None:
            look = replace(look, X_BF=np.array(arm.chain.forward(q)), q=q)
        why = collecting.offer(look)
        if why:
            return why
        try:
            folder.add(stamp, pair, None if arm is None else q)
        except OSError as error:
            collecting.undo()
            return f"The view is not stored: {error}."
        return collector.hint(collecting.missing)

    def step_on(self, before: Callable[[], None] = lambda: None) -> bool:
        """Solve when the views suffice or a person asked for it; True: the step is done.

        It takes seconds. `status` says SOLVING meanwhile, and ``before`` is called first.
        """
        with self._lock:
            collecting, folder, step = self._collector, self._folder, self.status.step
            due = collecting is not None and (self._asked or collecting.complete)
            if not self._collecting or not due:
                return False
            self._asked = False
            self._publish(state=CalibrationState.SOLVING, hint="Solving.")
        assert collecting is not None and folder is not None and step is not None
        before()
        solved, residual, lines = self._solve(step, folder.path)
        with self._lock:
            if solved:
                state, hint = CalibrationState.DONE, f"The step {step.value} is done."
                hint += " Restart the system." if self.write else ""
            else:
                state, hint = CalibrationState.COLLECTING, "Not accepted yet; see the reasons. "
                collecting.more()
                hint += collector.hint(collecting.missing).removeprefix("View taken. ")
            self._publish(state=state, hint=hint, result=tuple(lines), residual=residual)
        return solved

    def _solve(self, step: CalibrationStep, path: Path) -> tuple[bool, float, Sequence[str]]:
        """Whether it is accepted, its residual [px] (NaN: none), and lines for people."""
        origin, calibration = self.origin(step, path), self.cell.folder / "calibration"
        try:
            if step is CalibrationStep.STEREO and self.eyes == 1:
                lens, lines = steps.camera(calibration, path, origin, self.write)
                return True, lens.held_out, lines
            if step is CalibrationStep.STEREO:
                found, lines = steps.stereo(calibration, path, origin, self.lens_state, self.write)
                return True, found.held_out, lines
            result, lines = steps.handeye(self.cell, path, origin, self.write)
            return True, result.fit.rms, lines
        except steps.evidence.Refused as refused:
            return False, math.nan, refused.reasons
        except (ValueError, OSError, np.linalg.LinAlgError) as error:
            return False, math.nan, [str(error)]

    @property
    def _collecting(self) -> bool:
        return self.status.state is CalibrationState.COLLECTING

    def _publish(self, **changes: Any) -> None:
        """Make the status anew; with the lock held."""
        if (collecting := self._collector) is not None:
            changes |= {
                "views": len(collecting.taken),
                "wanted": collecting.wanted,
                "progress": collecting.progress,
                "missing": tuple(collecting.missing),
                "fields": tuple(collecting.fields.tolist()),
                "needed": tuple(collector.needed_fields(collecting.size).tolist()),
            }
        self.status = replace(self.status, **changes)
