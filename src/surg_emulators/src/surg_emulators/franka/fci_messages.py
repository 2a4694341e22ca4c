"""Messages of Franka's research interface, versions 5 (FER) and 10 (FR3): bytes to values and back.

A TCP message is a header of 12 bytes (command, number, size with the header) and a body; numbers
are little-endian and packed. States and commands are UDP datagrams of fixed size.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from surg_emulators.franka.franka_errors import FLAGS

HEADER = struct.Struct("<III")
CONNECT = struct.Struct("<HH")
MOVE = struct.Struct("<II6d")
MODE_NAMES = (
    "joint_position",
    "joint_velocity",
    "cartesian_position",
    "cartesian_velocity",
    "none",
)
CONTROLLERS = ("joint_impedance", "cartesian_impedance", "external")
IDLE_GENERATOR, IDLE_CONTROLLER = 0, 3
"""In a state: no motion generator, no controller of a client. A generator's number is one more than
in the request."""

_COMMON = ("success", "not_possible")
_SETTER = (*_COMMON, "invalid_argument")
_SAFETY = "rejected_for_safety"
_SETTERS = {
    "set_collision_behavior": "52d",
    "set_joint_impedance": "7d",
    "set_cartesian_impedance": "6d",
    "set_guiding_mode": "7?",
    "set_ee_to_k": "16d",
    "set_ne_to_ee": "16d",
    "set_load": "13d",
}
"""Setter -> layout of its body."""
_FIELDS = (
    ("O_T_EE", 16), ("O_T_EE_d", 16), ("F_T_EE", 16), ("EE_T_K", 16), ("F_T_NE", 16),
    ("NE_T_EE", 16), ("m_ee", 1), ("I_ee", 9), ("F_x_Cee", 3), ("m_load", 1), ("I_load", 9),
    ("F_x_Cload", 3), ("elbow", 2), ("elbow_d", 2), ("tau_J", 7), ("tau_J_d", 7), ("dtau_J", 7),
    ("q", 7), ("q_d", 7), ("dq", 7), ("dq_d", 7), ("ddq_d", 7), ("joint_contact", 7),
    ("cartesian_contact", 6), ("joint_collision", 7), ("cartesian_collision", 6),
    ("tau_ext_hat_filtered", 7), ("O_F_ext_hat_K", 6), ("K_F_ext_hat_K", 6), ("O_dP_EE_d", 6),
    ("O_ddP_O", 3), ("elbow_c", 2), ("delbow_c", 2), ("ddelbow_c", 2), ("O_T_EE_c", 16),
    ("O_dP_EE_c", 6), ("O_ddP_EE_c", 6), ("theta", 7), ("dtheta", 7),
)  # fmt: skip
_ACCELEROMETERS = (("accelerometer_top", 18), ("accelerometer_bottom", 18))


@dataclass(frozen=True)
class Protocol:
    """One version of the research interface.

    Attributes:
        version: Its number.
        commands: Number of a command -> its name.
        bodies: Setter -> layout of its body.
        statuses: Command -> names of its statuses, in the order of their numbers.
        move_size: Smallest body of `move` [bytes].
        fields: Numbers of a state in their order: name and count.
        state: Layout of a state.
        command: Layout of a command datagram.
    """

    version: int
    commands: Mapping[int, str]
    bodies: Mapping[str, struct.Struct]
    statuses: Mapping[str, Sequence[str]]
    move_size: int
    fields: Sequence[tuple[str, int]]
    state: struct.Struct
    command: struct.Struct
    places: Mapping[str, slice] = field(init=False)
    numbers: int = field(init=False)

    def __post_init__(self) -> None:
        places, at = {}, 0
        for name, count in self.fields:
            places[name] = slice(at, at + count)
            at += count
        object.__setattr__(self, "places", places)
        object.__setattr__(self, "numbers", at)

    def status(self, command: str, name: str) -> int:
        """Number of a status of a command; statuses that this version lacks become `aborted`."""
        known = self.statuses.get(command, _SETTER)
        return known.index(name if name in known else known[-1])


def _statuses(new: bool) -> dict[str, Sequence[str]]:
    """Statuses of the commands; newer versions have some more in the middle."""
    safety = (_SAFETY,) if new else ()
    moved = ("success", "started", "preempted", *(("preempted_for_safety", *safety) if new else ()))
    refused = ("not_possible", "singular", "invalid_argument")
    stopped, recovered = ("emergency", "reflex", "aborted"), ("reflex", "emergency", "aborted")
    return {
        "connect": ("success", "incompatible"),
        "move": (*moved, *refused, "reflex", "emergency", "input_error", "aborted"),
        "stop_move": (*_COMMON, *safety, *stopped),
        "automatic_error_recovery": (*_COMMON, *safety, "manual", *recovered),
        "load_model_library": ("success", "error"),
    }


def _protocol(version: int, names: Sequence[str], setters: Mapping[str, str]) -> Protocol:
    new = version >= 10
    fields = (*_FIELDS, *(_ACCELEROMETERS if new else ()))
    count, code = sum(size for _, size in fields), "f" if new else "d"
    return Protocol(
        version=version,
        commands=dict(enumerate(names)),
        bodies={name: struct.Struct("<" + layout) for name, layout in setters.items()},
        statuses=_statuses(new),
        move_size=113 if new else MOVE.size,
        fields=fields,
        state=struct.Struct(f"<Q{count}{code}BB{FLAGS}s{FLAGS}sB{code}"),
        command=struct.Struct("<Q7d7d16d6d2d??7d" + ("?" if new else "")),
    )


_NAMES = ("connect", "move", "stop_move")
PROTOCOLS = {
    5: _protocol(
        5,
        (
            *_NAMES,
            "get_cartesian_limit",
            *_SETTERS,
            "set_filters",
            "automatic_error_recovery",
            "load_model_library",
        ),
        {**_SETTERS, "set_filters": "5d", "get_cartesian_limit": "i"},
    ),
    10: _protocol(
        10, (*_NAMES, *_SETTERS, "automatic_error_recovery", "get_robot_model"), _SETTERS
    ),
}
"""Version -> protocol. Sources: libfranka's published message types of 0.9.2 and 0.21."""


@dataclass(frozen=True)
class MotionCommand:
    """What a client commands in one cycle.

    Attributes:
        message: Number of the state that it answers.
        q: Joint positions [rad], 7.
        dq: Joint velocities [rad/s], 7.
        finished: Whether the motion ends with it.
    """

    message: int
    q: Sequence[float]
    dq: Sequence[float]
    finished: bool


def parse_command(protocol: Protocol, data: bytes) -> MotionCommand | None:
    """The command of a datagram; None: it has another size."""
    if len(data) != protocol.command.size:
        return None
    values = protocol.command.unpack(data)
    return MotionCommand(values[0], values[1:8], values[8:15], values[40])


def message(command: int, number: int, body: bytes) -> bytes:
    """A TCP message."""
    return HEADER.pack(command, number, HEADER.size + len(body)) + body


def pack_state(
    protocol: Protocol,
    number: int,
    values: Sequence[float],
    modes: tuple[int, int, int],
    errors: bytes,
    reflex: bytes,
    success_rate: float,
) -> bytes:
    """A state's datagram.

    Args:
        protocol: Version.
        number: Of the state.
        values: All numbers in the order of `Protocol.fields`.
        modes: Motion generator, controller, robot.
        errors: Flags of the present errors.
        reflex: Flags of the errors that ended the last motion.
        success_rate: Share of commands that arrived.
    """
    generator, controller, robot = modes
    return protocol.state.pack(
        number, *values, generator, controller, errors, reflex, robot, success_rate
    )
