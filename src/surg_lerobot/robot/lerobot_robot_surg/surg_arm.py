"""The arms of a model server as one robot; every step passes its safety controller."""

import atexit
import logging
from dataclasses import dataclass
from typing import Any

from lerobot.robots import Robot, RobotConfig

from surg_policy_client import RemoteEnv
from surg_policy_client.adapters.by_name import ArmByName
from surg_policy_client.serving import ADDRESS

_OPEN: dict[str, ArmByName] = {}
"""Of this process by address: a server takes one policy, and robot and teleoperator share it."""


@RobotConfig.register_subclass("surg_arm")
@dataclass(kw_only=True)
class SurgArmConfig(RobotConfig):
    """Options ``--robot.…``."""

    server: str = ADDRESS
    """Address of the model server."""
    keys: str | None = None
    """Folder of ``./surg policy keys``, if the server has keys."""
    picture_width: int | None = None
    """What the server's pictures are scaled to [px], as in training."""
    timeout_s: float = 30.0
    """Longest wait for the server, for an episode and for an observation [s]."""


def connection(config: SurgArmConfig) -> ArmByName:
    """The arms of a server; connects at the first call of this process.

    Raises:
        NoServer: None answers.
    """
    if config.server not in _OPEN:
        env = RemoteEnv(config.server, keys=config.keys, timeout_s=config.timeout_s)
        atexit.register(env.close)  # the arm holds, however LeRobot ends
        _OPEN[config.server] = ArmByName(env, config.picture_width)
    return _OPEN[config.server]


class SurgArm(Robot):
    """See `SurgArmConfig`. To know its features it asks the server, which moves nothing."""

    config_class = SurgArmConfig
    name = "surg_arm"

    def __init__(self, config: SurgArmConfig) -> None:
        super().__init__(config)
        self.config = config
        self._begun = False

    @property
    def cameras(self) -> dict[str, Any]:
        """Name of each camera → its shape; LeRobot counts them."""
        return connection(self.config).pictures

    @property
    def observation_features(self) -> dict[str, Any]:
        """Name → ``float``, or the shape of a picture."""
        return connection(self.config).observation_features

    @property
    def action_features(self) -> dict[str, type]:
        """Name → ``float``."""
        return connection(self.config).action_features

    @property
    def is_connected(self) -> bool:
        """Whether an episode has begun."""
        return self._begun

    def connect(self, calibrate: bool = True) -> None:
        """Wait until the policy is enabled on the robot's side; nothing moves by itself.

        Raises:
            NoServer: It is not in time.
        """
        connection(self.config).begin()
        self._begun = True

    def get_observation(self) -> dict[str, Any]:
        """Wait for the next observation; says what the server refused."""
        arm = connection(self.config)
        seen = arm.observe()
        for step in arm.refused:
            logging.warning("step %(step)s refused (%(rule)s): %(text)s", step)
        return seen

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Send an action for the next grid time; the server may refuse it."""
        connection(self.config).send(action)
        return action

    def disconnect(self) -> None:
        """End the session; the arm holds."""
        self._begun = False
        if arm := _OPEN.pop(self.config.server, None):
            arm.env.close()

    # --- the platform calibrates -------------------------------------------------------------

    @property
    def is_calibrated(self) -> bool:
        """Always."""
        return True

    def calibrate(self) -> None:
        """Nothing to do."""

    def configure(self) -> None:
        """Nothing to do."""
