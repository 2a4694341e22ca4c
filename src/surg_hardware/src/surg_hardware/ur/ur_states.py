"""What a state of RTDE means to the link. No socket."""

from __future__ import annotations

from surg_hardware.conditions import ur_reading
from surg_hardware.identity import ur_flange, ur_wrench
from surg_hardware.robot_adapter import ArmIdentity
from surg_hardware.robot_link import RobotState
from surg_hardware.ur import urscript
from surg_hardware.ur.rtde import Values

_PLAYING = 2
_PAUSED = (3, 4)  # pausing, paused
_TEACH_BUTTON = 4  # bit of robot_status_bits


def robot_state(values: Values, starting: bool = False) -> RobotState:
    """What a state of RTDE means to the link.

    ``starting``: the link's own program has been uploaded. Registers outlive a program, so that of
    hand guiding means nothing until the new program has written it.
    """
    playing = values["runtime_state"][0] == _PLAYING
    guided = bool(int(values["robot_status_bits"][0]) & _TEACH_BUTTON) or (
        playing and not starting and says_guiding(values)
    )
    paused = values["runtime_state"][0] in _PAUSED
    return RobotState(
        time=values["timestamp"][0],
        q=values["actual_q"],
        qd=values["actual_qd"],
        reading=ur_reading(
            int(values["robot_mode"][0]),
            int(values["safety_status"][0]),
            values["speed_scaling"][0],
            guided,
            slider=values["target_speed_fraction"][0],
            paused=paused,
        ),
        program=playing,
        paused=paused,
        executed=int(values["output_int_register_24"][0]),
        ahead=tuple(b - a for a, b in zip(values["actual_q"], values["target_q"], strict=True)),
        wrench=ur_wrench(values["actual_TCP_force"]),
    )


def arm_identity(values: Values, serial: str, model: str) -> ArmIdentity:
    """What the robot says of itself, with what its orders' server tells."""
    flange = ur_flange(values["actual_TCP_pose"], values["tcp_offset"])
    x, y, z = values["payload_cog"]
    rows = tuple(flange[:3].ravel().tolist())
    return ArmIdentity(model, rows, serial, values["payload"][0], (x, y, z))


def says_guiding(values: Values) -> bool:
    """Whether the program on the robot says that a person guides the arm."""
    return bool(values["output_int_register_25"][0] == urscript.GUIDING)


_SET = {
    "payload": ("the payload", "kg"),
    "payload_cog": ("the payload's centre of gravity", "m"),
    "tcp_offset": ("the tool centre point", "m, rad"),
}
"""What a person sets on the robot: field -> its name and unit."""


class SetValues:
    """Notices that payload, centre of gravity or tool centre point is no longer what it was."""

    def __init__(self) -> None:
        self._known: Values = {}

    def know(self, values: Values) -> None:
        """These have been taken note of."""
        self._known = {name: values[name] for name in _SET}

    def change(self, values: Values) -> str:
        """What differs from the values that are known, in one sentence; empty: nothing."""
        for name, (what, unit) in _SET.items():
            before, after = self._known.get(name, values[name]), values[name]
            if before != after:
                change = f"from {_said(before)} to {_said(after)} {unit}"
                return f"{what} was changed on the robot {change}"
        return ""


def _said(values: tuple[float, ...]) -> str:
    text = ", ".join(f"{value:g}" for value in values)
    return f"[{text}]" if len(values) > 1 else text
