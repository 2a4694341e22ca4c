"""Fields of RTDE: names, types and how an emulated controller answers them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from surg_emulators.ur import robot_states
from surg_emulators.ur.robot_states import RobotMode

if TYPE_CHECKING:
    from surg_emulators.ur.ur_controller import UrController

PACKING = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
"""Type -> its bytes on the wire, as `struct` writes them (big-endian)."""
COUNT = {name: int(code[0]) if code[0].isdigit() else 1 for name, code in PACKING.items()}
REGISTERS = {"bit": (128, "BOOL"), "int": (48, "INT32"), "double": (48, "DOUBLE")}
"""Kind of register -> how many there are of it, and their type."""

Get = Callable[["UrController"], Any]


def _six(value: float) -> Get:
    return lambda controller: [value] * 6


OUTPUTS: dict[str, tuple[str, Get]] = {
    "timestamp": ("DOUBLE", lambda c: c.timestamp),
    "target_q": ("VECTOR6D", lambda c: c.motion.q),
    "target_qd": ("VECTOR6D", lambda c: c.motion.qd),
    "target_qdd": ("VECTOR6D", lambda c: c.motion.qdd),
    "target_current": ("VECTOR6D", _six(0.0)),
    "target_moment": ("VECTOR6D", _six(0.0)),
    "actual_q": ("VECTOR6D", lambda c: c.shown_q),
    "actual_qd": ("VECTOR6D", lambda c: c.motion.actual_qd),
    "actual_current": ("VECTOR6D", _six(0.0)),
    "actual_current_window": ("VECTOR6D", _six(1.0)),
    "joint_control_output": ("VECTOR6D", _six(0.0)),
    "actual_TCP_pose": ("VECTOR6D", lambda c: c.tcp_pose(c.motion.actual_q)),
    "actual_TCP_speed": ("VECTOR6D", lambda c: c.tcp_speed(c.motion.actual_q, c.motion.actual_qd)),
    "actual_TCP_force": ("VECTOR6D", lambda c: c.wrench),
    "target_TCP_pose": ("VECTOR6D", lambda c: c.tcp_pose(c.motion.q)),
    "target_TCP_speed": ("VECTOR6D", lambda c: c.tcp_speed(c.motion.q, c.motion.qd)),
    "actual_digital_input_bits": ("UINT64", lambda c: 0),
    "joint_temperatures": ("VECTOR6D", _six(28.0)),
    "actual_execution_time": ("DOUBLE", lambda c: 0.2),
    "robot_mode": ("INT32", lambda c: c.shown_mode),
    "joint_mode": (
        "VECTOR6INT32",
        lambda c: [robot_states.joint_mode(c.shown_mode, c.safety_mode)] * 6,
    ),
    "safety_mode": ("INT32", lambda c: c.safety_mode),
    "safety_status": ("INT32", lambda c: c.safety_mode),
    "actual_tool_accelerometer": ("VECTOR3D", lambda c: [0.0, 0.0, -9.82]),
    # Of the trajectory limiter, which never intervenes here. Slider and pause are not in it.
    "speed_scaling": ("DOUBLE", lambda c: c.faked.get("speed_scaling", 1.0)),
    "target_speed_fraction": ("DOUBLE", lambda c: c.slider),
    "actual_momentum": ("DOUBLE", lambda c: 0.0),
    "actual_main_voltage": ("DOUBLE", lambda c: 48.0),
    "actual_robot_voltage": ("DOUBLE", lambda c: 48.0 if c.powered else 0.0),
    "actual_robot_current": ("DOUBLE", lambda c: 1.0 if c.powered else 0.0),
    "actual_joint_voltage": ("VECTOR6D", lambda c: [48.0 if c.powered else 0.0] * 6),
    "actual_digital_output_bits": ("UINT64", lambda c: c.digital_outputs),
    "runtime_state": ("UINT32", lambda c: c.runtime),
    "elbow_position": ("VECTOR3D", lambda c: c.elbow()),
    "elbow_velocity": ("VECTOR3D", lambda c: [0.0] * 3),
    "robot_status_bits": (
        "UINT32",
        lambda c: robot_states.robot_status_bits(c.powered, c.program_runs, c.guided),
    ),
    "safety_status_bits": ("UINT32", lambda c: robot_states.safety_status_bits(c.safety_mode)),
    "analog_io_types": ("UINT32", lambda c: 0),
    "standard_analog_input0": ("DOUBLE", lambda c: 0.0),
    "standard_analog_input1": ("DOUBLE", lambda c: 0.0),
    "standard_analog_output0": ("DOUBLE", lambda c: 0.0),
    "standard_analog_output1": ("DOUBLE", lambda c: 0.0),
    "io_current": ("DOUBLE", lambda c: 0.0),
    "tool_mode": ("UINT32", lambda c: 253 if c.shown_mode == RobotMode.RUNNING else 255),
    "tool_analog_input_types": ("UINT32", lambda c: 0),
    "tool_analog_input0": ("DOUBLE", lambda c: 0.0),
    "tool_analog_input1": ("DOUBLE", lambda c: 0.0),
    "tool_output_voltage": ("INT32", lambda c: 0),
    "tool_output_mode": ("UINT8", lambda c: 0),
    "tool_digital_output0_mode": ("UINT8", lambda c: 0),
    "tool_digital_output1_mode": ("UINT8", lambda c: 0),
    "tool_output_current": ("DOUBLE", lambda c: 0.0),
    "tool_temperature": ("DOUBLE", lambda c: 28.0),
    "tcp_force_scalar": ("DOUBLE", lambda c: sum(f * f for f in c.wrench[:3]) ** 0.5),
    "output_bit_registers0_to_31": ("UINT32", lambda c: _bits(c.outputs["bit"], 0)),
    "output_bit_registers32_to_63": ("UINT32", lambda c: _bits(c.outputs["bit"], 32)),
    "input_bit_registers0_to_31": ("UINT32", lambda c: _bits(c.inputs["bit"], 0)),
    "input_bit_registers32_to_63": ("UINT32", lambda c: _bits(c.inputs["bit"], 32)),
    "payload": ("DOUBLE", lambda c: c.payload),
    "payload_cog": ("VECTOR3D", lambda c: c.payload_cog),
    "payload_inertia": ("VECTOR6D", _six(0.0)),
    "script_control_line": ("UINT32", lambda c: c.program_line),
    "ft_raw_wrench": ("VECTOR6D", lambda c: c.wrench),
    "joint_position_deviation_ratio": ("DOUBLE", lambda c: 0.0),
    "collision_detection_ratio": ("DOUBLE", lambda c: 0.0),
    "time_scale_source": ("INT32", lambda c: -1),
    "tcp_offset": ("VECTOR6D", lambda c: c.tcp_offset),
    "actual_current_as_torque": ("VECTOR6D", _six(0.0)),
    "actual_TCP_acceleration": ("VECTOR6D", _six(0.0)),
    "target_TCP_acceleration": ("VECTOR6D", _six(0.0)),
    "actual_configurable_digital_input_bits": ("UINT64", lambda c: 0),
    "actual_configurable_digital_output_bits": ("UINT64", lambda c: c.digital_outputs >> 8),
    "target_execution_time": ("DOUBLE", lambda c: 0.2),
    "actual_robot_energy_consumed": ("DOUBLE", lambda c: 0.0),
    "actual_robot_braking_energy_dissipated": ("DOUBLE", lambda c: 0.0),
    "encoder0_raw": ("INT32", lambda c: 0),
    "encoder1_raw": ("INT32", lambda c: 0),
    "euromap67_input_bits": ("UINT32", lambda c: 0),
    "euromap67_output_bits": ("UINT32", lambda c: 0),
    "euromap67_24V_voltage": ("DOUBLE", lambda c: 0.0),
    "euromap67_24V_current": ("DOUBLE", lambda c: 0.0),
    "wrench_calc_from_currents": ("VECTOR6D", _six(0.0)),
    "target_gravity": ("VECTOR3D", lambda c: [0.0, 0.0, 9.82]),
    "target_base_acceleration": ("VECTOR6D", _six(0.0)),
    "target_base_wrench": ("VECTOR6D", _six(0.0)),
    "control_step": ("UINT64", lambda c: c.cycles),
}
"""What a client may ask for: name -> type, value."""

INPUTS: dict[str, str] = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    "external_force_torque": "VECTOR6D",
}
"""What a client may set: name -> type."""


def _bits(registers: Sequence[bool], first: int) -> int:
    return sum(bool(bit) << place for place, bit in enumerate(registers[first : first + 32]))


def _register(side: str, kind: str, number: int) -> Get:
    return lambda controller: getattr(controller, side)[kind][number]


def _add_registers() -> None:
    for kind, (count, code) in REGISTERS.items():
        for number in range(count):
            if kind != "bit" or number >= 64:
                INPUTS[f"input_{kind}_register_{number}"] = code
            for side in ("input", "output"):
                name = f"{side}_{kind}_register_{number}"
                OUTPUTS[name] = (code, _register(f"{side}s", kind, number))


_add_registers()
