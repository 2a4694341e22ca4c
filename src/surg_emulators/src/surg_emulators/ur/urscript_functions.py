"""URScript's own functions, as the emulated controller answers them.

Functions that the emulator knows but does not emulate end the program with a message that names
them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from surg_emulators.ur import dh_kinematics as dh
from surg_emulators.ur.joint_motion import DT, Speed
from surg_emulators.ur.rtde_fields import REGISTERS
from surg_emulators.ur.urscript_arguments import close, cycles, matrix, number, six
from surg_emulators.ur.urscript_moves import during, positions
from surg_emulators.ur.urscript_syntax import ScriptError
from surg_emulators.ur.urscript_threads import Builtin, Wait
from surg_emulators.ur.urscript_values import Pose

if TYPE_CHECKING:
    from surg_emulators.ur.ur_controller import UrController

_REFUSED = (
    "servoc direct_torque get_mass_matrix get_jacobian force_mode end_force_mode "
    "tool_contact get_actual_joint_positions_history "
    "get_jacobian_time_derivative get_coriolis_and_centrifugal_torques "
    "socket_read_ascii_float socket_send_string "
    "socket_set_var socket_get_var path_offset_enable conveyor_pulse_decode "
    "get_target_waypoint set_conveyor_tick_count modbus_add_signal"
)
NOT_EMULATED = frozenset(_REFUSED.split())
"""Real functions of URScript: a program may contain them, but not call them here."""
_IGNORED = (
    "force_mode_set_gain_scaling force_mode_set_damping zero_ftsensor set_gravity "
    "enable_external_ft_sensor ft_rtde_input_enable set_tool_voltage set_analog_outputdomain "
    "set_standard_analog_input_domain set_tool_communication popup"
)
WITHOUT_EFFECT = frozenset(_IGNORED.split())
"""Real functions of URScript that change nothing here."""
_MATHEMATICS = "sin cos tan asin acos atan atan2 sqrt pow floor ceil log"


def functions(controller: UrController) -> dict[str, Builtin]:
    """Name -> function, for programs of one controller."""
    found: dict[str, Builtin] = {name: _not_emulated(name) for name in NOT_EMULATED}
    found |= {name: lambda *a, **k: None for name in WITHOUT_EFFECT}
    for part in (_state, _velocities, positions, _inputs):
        found |= part(controller)
    return found | controller.sockets.functions() | _mathematics()


def _not_emulated(name: str) -> Builtin:
    def refuse(*values: Any, **named: Any) -> None:
        raise ScriptError(f"{name} is not emulated")

    return refuse


def _mathematics() -> dict[str, Builtin]:
    plain = {name: getattr(math, name) for name in _MATHEMATICS.split()}
    return plain | {
        "abs": abs,
        "max": max,
        "min": min,
        "d2r": math.radians,
        "r2d": math.degrees,
        "norm": lambda a: math.sqrt(sum(x * x for x in a)) if isinstance(a, list) else abs(a),
        "length": len,
        "get_list_length": len,
        "to_num": float,
        "to_str": lambda a: str(a)[:1000],
        "str_cat": lambda a, b: (str(a) + str(b))[:1000],
        "integer_to_boolean": bool,
        "pose_trans": lambda a, b: _pose(matrix(a) @ matrix(b)),
        "pose_inv": lambda a: _pose(np.linalg.inv(matrix(a))),
        "pose_add": _pose_add,
        "pose_sub": _pose_sub,
        "pose_dist": lambda a, b: math.dist(a[:3], b[:3]),
        "point_dist": lambda a, b: math.dist(a[:3], b[:3]),
    }


def _pose(X: dh.Matrix) -> Pose:
    return Pose(dh.pose_vector(X))


def _pose_add(a: Any, b: Any) -> Pose:
    """Positions are added; the rotations are applied one after the other."""
    X = matrix(a)
    X[:3, :3] = X[:3, :3] @ matrix(b)[:3, :3]
    X[:3, 3] += b[:3]
    return _pose(X)


def _pose_sub(a: Any, b: Any) -> Pose:
    X = matrix(a)
    X[:3, :3] = X[:3, :3] @ matrix(b)[:3, :3].T
    X[:3, 3] -= b[:3]
    return _pose(X)


def _state(c: UrController) -> dict[str, Builtin]:
    """Functions that read the arm."""

    def solve(pose: Any, near: Any = None, *rest: Any, **named: Any) -> list[float] | None:
        start = c.motion.q if near is None else six(near, "qnear")
        return dh.inverse(matrix(pose), start, c.table, dh.pose_matrix(c.tcp_offset))

    def inverse(*values: Any, **named: Any) -> list[float]:
        q = solve(*values, **named)
        if q is None:
            raise ScriptError("get_inverse_kin: no solution for this pose")
        return q

    def forward(q: Any = None, tcp: Any = None) -> Pose:
        X = dh.frames(c.motion.actual_q if q is None else six(q, "q"), c.table)[-1]
        return _pose(X @ (matrix(c.tcp_offset if tcp is None else tcp)))

    return {
        "get_actual_joint_positions": lambda: list(c.motion.actual_q),
        "get_joint_positions": lambda: list(c.motion.actual_q),
        "get_actual_joint_speeds": lambda: list(c.motion.actual_qd),
        "get_target_joint_positions": lambda: list(c.motion.q),
        "get_target_joint_speeds": lambda: list(c.motion.qd),
        "get_target_joint_accelerations": lambda: list(c.motion.qdd),
        "get_joint_torques": lambda: [0.0] * 6,
        "get_joint_temp": lambda joint: 28.0,
        "get_actual_tcp_pose": lambda: Pose(c.tcp_pose(c.motion.actual_q)),
        "get_target_tcp_pose": lambda: Pose(c.tcp_pose(c.motion.q)),
        "get_actual_tcp_speed": lambda: c.tcp_speed(c.motion.actual_q, c.motion.actual_qd),
        "get_target_tcp_speed": lambda: c.tcp_speed(c.motion.q, c.motion.qd),
        "get_actual_tool_flange_pose": lambda: forward(None, [0.0] * 6),
        "get_tcp_force": lambda: list(c.wrench),
        "get_tcp_offset": lambda: Pose(c.tcp_offset),
        "get_target_payload": lambda: c.payload,
        "get_target_payload_cog": lambda: list(c.payload_cog),
        "get_target_payload_inertia": lambda: [0.0] * 6,
        "get_steptime": lambda: DT,
        "get_inverse_kin": inverse,
        "get_inverse_kin_has_solution": lambda *a, **k: solve(*a, **k) is not None,
        "get_forward_kin": forward,
        "is_steady": lambda: c.motion.at_rest,
        "is_within_safety_limits": lambda value: True,
        "get_freedrive_status": lambda: 0 if c.guided else 1,
    }


def _velocities(c: UrController) -> dict[str, Builtin]:
    """Functions that command velocities. A new command acts in the next cycle."""

    def speedj(qd: Any, a: Any = 1.4, t: Any = None) -> Wait:
        wanted = six(qd, "speedj: qd")
        c.motion.command = Speed(wanted, number(a, "speedj: a", 0.0))
        if t is None:
            return Wait(2, lambda: close(c.motion.qd, wanted, c.motion.scale), motion=True)
        return during(c.motion, t)

    def speedl(xd: Any, a: Any = 1.2, t: Any = None, **named: Any) -> Wait:
        J = dh.jacobian(c.motion.q, c.table, dh.pose_matrix(c.tcp_offset))
        try:
            qd = np.linalg.solve(J, np.array(six(xd, "speedl: xd")))
        except np.linalg.LinAlgError as error:
            raise ScriptError("speedl: the arm is in a singularity") from error
        # `a` is the tool's; the leading joint may use the most that a client can ask for.
        c.motion.command = Speed([float(each) for each in qd], 40.0)
        return during(c.motion, DT if t is None else t)

    def stop(a: Any = 2.0, *rest: Any, **named: Any) -> Wait:
        c.motion.command = Speed([0.0] * 6, number(a, "stop: a", 1e-6))
        return Wait(2, lambda: c.motion.at_rest, motion=True)

    return {"speedj": speedj, "speedl": speedl, "stopj": stop, "stopl": stop}


def _inputs(c: UrController) -> dict[str, Builtin]:
    """Registers, settings and what lets a thread wait."""

    def reader(side: str, kind: str) -> Builtin:
        return lambda place: getattr(c, side)[kind][_register(kind, place)]

    def writer(kind: str) -> Builtin:
        def write(place: Any, value: Any) -> None:
            if kind == "bit":
                kept: Any = bool(value)
            elif kind == "int":
                kept = int(number(value, "an integer register", -(2.0**31), 2.0**31 - 1))
            else:
                kept = float(value)
            c.outputs[kind][_register(kind, place)] = kept

        return write

    def set_payload(m: Any, cog: Any = None, inertia: Any = None) -> None:
        c.set_payload(number(m, "set_payload: m", 0.0, 20.0), cog or c.payload_cog)

    def set_tcp(pose: Any, name: Any = "") -> None:
        c.tcp_offset = six(pose, "set_tcp: pose")

    found: dict[str, Builtin] = {
        "sync": lambda: Wait(1),
        "sleep": lambda t: Wait(cycles(t)),
        "textmsg": lambda a, b="": c.say(f"{a}{b}"),
        "set_payload": set_payload,
        "set_target_payload": set_payload,
        "set_tcp": set_tcp,
        "rtde_set_watchdog": lambda variable, frequency, action="pause": c.set_watchdog(
            variable, number(frequency, "rtde_set_watchdog: frequency", 0.0, 500.0), action
        ),
        "set_standard_digital_out": lambda place, value: c.set_digital(int(place), bool(value)),
        "get_standard_digital_out": lambda place: bool(c.digital_outputs >> int(place) & 1),
        "get_standard_digital_in": lambda place: False,
    }
    for kind, words in {"bit": "boolean", "int": "integer", "double": "float"}.items():
        found[f"read_input_{words}_register"] = reader("inputs", kind)
        found[f"read_output_{words}_register"] = reader("outputs", kind)
        found[f"write_output_{words}_register"] = writer(kind)
    return found


def _register(kind: str, place: Any) -> int:
    count = REGISTERS[kind][0]
    if isinstance(place, bool) or not isinstance(place, int) or not 0 <= place < count:
        raise ScriptError(f"register {place!r} must be from 0 to {count - 1}")
    return place
