"""Moves the tip by a LeRobot teleoperator that gives ``delta_x``, ``delta_y``, ``delta_z``."""

from dataclasses import dataclass
from typing import Any

from lerobot.teleoperators import (
    Teleoperator,
    TeleoperatorConfig,
    gamepad,  # noqa: F401 (registers itself)
    keyboard,  # noqa: F401
    make_teleoperator_from_config,
)

from lerobot_robot_surg import SurgArmConfig, connection
from surg_policy_client.serving import ADDRESS


@TeleoperatorConfig.register_subclass("surg_hand")
@dataclass(kw_only=True)
class SurgHandConfig(TeleoperatorConfig):
    """Options ``--teleop.…``."""

    device: str = "gamepad"
    """In the hand: a type of teleoperator, such as ``keyboard_ee``, as it is by default."""
    server: str = ADDRESS
    """The robot's."""
    arm: str = "PSM1"
    step: float = 0.001
    """Way of a full deflection in one period of 50 ms [m], along the axes of the rcm frame."""
    turn: float = 0.05
    """Change of the jaw's angle while the gripper is opened or closed, in one period [rad]."""


class SurgHand(Teleoperator):
    """See `SurgHandConfig`. Its action goes on from where the arm is told to be."""

    config_class = SurgHandConfig
    name = "surg_hand"

    def __init__(self, config: SurgHandConfig) -> None:
        super().__init__(config)
        self.config = config
        kind = TeleoperatorConfig.get_choice_class(config.device)
        self._robot = SurgArmConfig(server=config.server)
        self._device = make_teleoperator_from_config(kind())

    @property
    def action_features(self) -> dict[str, type]:
        """The robot's."""
        return connection(self._robot).action_features

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Of the device."""
        return bool(self._device.is_connected)

    def connect(self, calibrate: bool = True) -> None:
        """Open the device."""
        self._device.connect()

    def get_action(self) -> dict[str, Any]:
        """The device's deflection as the robot's next action."""
        wanted = self.config
        hand = self._device.get_action()
        return connection(self._robot).nudged(hand, wanted.step, wanted.turn, wanted.arm)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Nothing to feel."""

    def disconnect(self) -> None:
        """Close the device."""
        self._device.disconnect()

    # --- nothing to calibrate ----------------------------------------------------------------

    @property
    def is_calibrated(self) -> bool:
        """Always."""
        return True

    def calibrate(self) -> None:
        """Nothing to do."""

    def configure(self) -> None:
        """Nothing to do."""
