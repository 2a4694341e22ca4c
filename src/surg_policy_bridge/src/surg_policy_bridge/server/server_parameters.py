"""Parameters of the model server, checked once. No ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from surg_core.contract import GRID_RATE
from surg_policy_bridge.server import listen_address
from surg_policy_bridge.server.safety_controller import CLIPPABLE, CLIPPED
from surg_policy_client.spec_checks import MAX_TEXT
from surg_policy_client.wire import MAX_PARTS, MAX_SENTENCE
from surg_ros.params import ParamError, flag, names, one_of, real, text

MODES = ("lockstep", "freerun")
ADDRESS = "tcp://127.0.0.1:5555"


@dataclass(frozen=True)
class Settings:
    """Parameters of the node ``/policy``."""

    bind: str = text(ADDRESS)  # address at which policies connect
    # folder of `./surg policy keys`; empty: none, which allows this machine only
    keys: str = text("", empty=True)
    cell: str = text(allowed="the folder of a cell")  # path of the cell
    # arms that the policy commands, in the order of the action
    arms: tuple[str, ...] = names(("PSM1",), least=1)
    mode: str = one_of(MODES, "freerun")  # ``lockstep`` or ``freerun``
    task: str = text("", empty=True, longest=MAX_TEXT)  # name of the task, for the specification
    instruction: str = text("", empty=True, longest=MAX_SENTENCE)
    privileged: bool = flag(False)  # serve the simulator's ground truth (``privileged.task_state``)
    forces: bool = flag(False)  # serve the forces at tip and trocar (``observation.force``)
    cameras: tuple[str, ...] = names(())  # observed cameras, such as ``endoscope_left``
    camera_rate: float = real(1.0, 240.0, float(GRID_RATE))  # pictures per second [1/s]
    # rules that clip a step instead of rejecting it
    clip: tuple[str, ...] = names(tuple(CLIPPED), options=tuple(CLIPPABLE))
    autostart: bool = flag(False)  # enable every new session at once
    # run only while the teleoperation's status is fresh and states that no hand wants an arm.
    # False: a system without an operator, such as a roll-out
    need_teleop: bool = flag(True)
    # run only while the operator is at the controls (operator_present of the console or the foot
    # pedals, repeated 20 times per second)
    need_present: bool = flag(False)
    # longest wall-clock wait for an answer in lock-step [s]
    answer_timeout: float = real(0.1, 9.0, 9.0)

    def __post_init__(self) -> None:
        """Rules between parameters."""
        try:
            listen_address.check(self.bind, bool(self.keys))
        except listen_address.BindError as error:
            raise ParamError("bind", self.bind, str(error)) from error
        if self.autostart and self.need_teleop:  # its first status comes later than the session
            raise ParamError("autostart", True, "false, or ~need_teleop: false (no operator)")
        most = MAX_PARTS - 3 - self.privileged - self.forces  # beside header, states, rcm frames
        if len(self.cameras) > most:
            raise ParamError("cameras", list(self.cameras), f"at most {most}")

    @property
    def lockstep(self) -> bool:
        """Whether it runs in lock-step with the simulator."""
        return self.mode == "lockstep"

    def check_arms(self, names: Sequence[str], links: Sequence[str]) -> None:
        """Check the arms against those of the cell and the links of those.

        Raises:
            ParamError: An arm is unknown, or a real arm has no ground truth.
        """
        link_of = dict(zip(names, links, strict=True))
        if any(arm not in link_of for arm in self.arms):
            raise ParamError("arms", list(self.arms), f"the cell has {', '.join(link_of)}")
        real = [arm for arm in self.arms if link_of[arm] != "simulator"]
        if self.privileged and real:
            raise ParamError(
                "privileged",
                True,
                f"false, because {', '.join(real)} is not simulated: only the simulator has ground "
                "truth",
            )
