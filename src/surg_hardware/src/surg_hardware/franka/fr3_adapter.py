"""FR3 (Franka Research 3) by the maker's pylibfranka."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pylibfranka  # type: ignore[import]

from surg_hardware.arm_driver import RobotRefused
from surg_hardware.franka import joint_limits
from surg_hardware.franka.franka_adapter import FrankaAdapter, MotionEnded, as_error
from surg_hardware.franka.versions import refusal

_ERRORS = (pylibfranka.FrankaException, RuntimeError)


class Driver(FrankaAdapter):
    """One FR3."""

    model = "fr3"
    limits = joint_limits.FR3
    _robot: Any = None
    _control: Any = None

    def connect(self) -> None:
        """As `RobotAdapter.connect`; sets the collision thresholds."""
        # The driver has asked for a real-time priority itself, and refuses a real arm without.
        try:
            self._robot = pylibfranka.Robot(self.address, pylibfranka.RealtimeConfig.kIgnore)
            torque, force = self._torque, self._force
            self._robot.set_collision_behavior(torque, torque, force, force)
        except _ERRORS as error:
            if why := refusal(str(error), self.model):
                raise RobotRefused(why) from error
            raise as_error(error) from error

    def recover(self) -> str:
        """As `RobotAdapter.recover`; the library blocks until the robot has recovered."""
        try:
            self._robot.automatic_error_recovery()
        except _ERRORS as error:
            return str(error)
        return ""

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
