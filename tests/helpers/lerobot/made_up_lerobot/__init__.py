"""What a LeRobot user has besides: a device, found by ``--teleop.discover_packages_path``."""

from dataclasses import dataclass
from typing import Any

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from made_up_lerobot.configuration_sweep import SweepConfig

__all__ = ["SweepConfig", "Tilted", "TiltedConfig"]


@TeleoperatorConfig.register_subclass("tilted")
@dataclass(kw_only=True)
class TiltedConfig(TeleoperatorConfig):
    """A stick that somebody holds half way along x."""


class Tilted(Teleoperator):
    """The stick."""

    config_class = TiltedConfig
    name = "tilted"
    is_connected, is_calibrated = False, True
    action_features: dict[str, type] = {}
    feedback_features: dict[str, type] = {}

    def connect(self, calibrate: bool = True) -> None:
        """Plug it in."""
        self.is_connected = True

    def get_action(self) -> dict[str, Any]:
        """Half a deflection; the gripper stays."""
        return {"delta_x": 0.5, "delta_y": 0.0, "delta_z": 0.0, "gripper": 1}

    def calibrate(self) -> None:
        """Nothing."""

    def configure(self) -> None:
        """Nothing."""

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Nothing."""

    def disconnect(self) -> None:
        """Unplug it."""
        self.is_connected = False
