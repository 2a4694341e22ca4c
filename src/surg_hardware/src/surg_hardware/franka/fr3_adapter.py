"""FR3 (Franka Research 3) by the maker's pylibfranka."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pylibfranka  # type: ignore[import]

from surg_hardware.franka import joint_limits
from surg_hardware.franka.franka_adapter import FrankaAdapter, MotionEnded, as_error

_ERRORS = (pylibfranka.FrankaException, RuntimeError)


class Driver(FrankaAdapter):
    """One FR3."""

    model = "fr3"
    limits = joint_limits.FR3
    library, errors = pylibfranka, _ERRORS
    _control: Any = None

    def close(self) -> None:
        """As `RobotAdapter.close`."""
        self._robot = self._control = None
        self._moving = False

    def _read(self) -> Any:
        try:
            if not self._moving:
                self._control = None
                return self._robot.read_once()
            return self._control.readOnce()[0]
        except pylibfranka.ControlException as error:
            raise MotionEnded(str(error)) from error
        except _ERRORS as error:
            raise as_error(error) from error

    def _begin(self) -> None:
        mode = pylibfranka.ControllerMode.JointImpedance
        try:
            self._control = self._robot.start_joint_velocity_control(mode)
        except _ERRORS as error:
            raise as_error(error) from error

    def _write(self, velocities: Sequence[float], finished: bool) -> None:
        command = pylibfranka.JointVelocities(velocities)
        command.motion_finished = finished
        try:
            self._control.writeOnce(command)
        except pylibfranka.ControlException as error:
            raise MotionEnded(str(error)) from error
        except _ERRORS as error:
            raise as_error(error) from error
