"""Franka Emika Panda by panda-python, which has libfranka 0.9.2.

That library moves the arm by a callback for each millisecond. It runs in a thread of its own here;
the two threads hand states and answers over to each other and never run at the same time.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence
from typing import Any

from panda_py import libfranka  # type: ignore[import]

from surg_hardware.franka import joint_limits
from surg_hardware.franka.franka_adapter import FrankaAdapter, MotionEnded, as_error

WAIT = 0.1
"""[s] For the next state of a motion: the library itself waits longer."""
NO_FILTER = 1000.0
"""[Hz] The library's own low-pass filter is off: it would delay the commands."""


class Driver(FrankaAdapter):
    """One Panda."""

    model = "panda"
    limits = joint_limits.PANDA
    library, errors = libfranka, (RuntimeError,)
    _motion: threading.Thread | None = None

    def close(self) -> None:
        """As `RobotAdapter.close`."""
        if self._motion is not None:
            self._answers.put(None)
        self._robot, self._motion, self._moving = None, None, False

    def _read(self) -> Any:
        if self._moving:
            try:
                state = self._states.get(timeout=WAIT)
            except queue.Empty as error:
                raise TimeoutError from error
            if isinstance(state, Exception):
                raise MotionEnded(str(state)) from state
            return state
        if self._motion is not None:
            self._motion.join()  # the library holds the robot until its motion has ended
            self._motion = None
        try:
            return self._robot.read_once()
        except RuntimeError as error:
            raise as_error(error) from error

    def _begin(self) -> None:
        self._states: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._motion = threading.Thread(target=self._move, daemon=True)
        self._motion.start()

    def _move(self) -> None:
        """The motion, in its own thread."""

        def answer(state: Any, _: Any) -> Any:
            self._states.put(state)
            command = self._answers.get()
            if command is None:
                raise RuntimeError("the driver has ended")
            return command

        mode = libfranka.ControllerMode.kJointImpedance
        try:
            self._robot.control_joint_velocity(answer, mode, False, NO_FILTER)
        except RuntimeError as error:
            self._states.put(error)

    def _write(self, velocities: Sequence[float], finished: bool) -> None:
        command = libfranka.JointVelocities(velocities)
        command.motion_finished = finished
        self._answers.put(command)
