"""Fields of RTDE: names, types and how an emulated controller answers them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from surg_emulators.ur import robot_states
from surg_emulators.ur.robot_states import RobotMode

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

Get = Callable[[Any], Any]
"""Gives a field's value, of the controller."""


OUTPUTS: dict[str, tuple[str, Get]] = {
    "timestamp": ("DOUBLE", lambda c: c.timestamp),
    "target_q": ("VECTOR6D", lambda c: c.motion.q),
    "target_qd": ("VECTOR6D", lambda c: c.motion.qd),
    "target_qdd": ("VECTOR6D", lambda c: c.motion.qdd),
    "actual_q": ("VECTOR6D", lambda c: c.shown_q),
    "actual_qd": ("VECTOR6D", lambda c: c.motion.actual_qd),
    "actual_TCP_pose": ("VECTOR6D", lambda c: c.tcp_pose(c.motion.actual_q)),
    "actual_TCP_speed": ("VECTOR6D", lambda c: c.tcp_speed(c.motion.actual_q, c.motion.actual_qd)),
    "actual_TCP_force": ("VECTOR6D", lambda c: c.wrench),
    "target_TCP_pose": ("VECTOR6D", lambda c: c.tcp_pose(c.motion.q)),
    "target_TCP_speed": ("VECTOR6D", lambda c: c.tcp_speed(c.motion.q, c.motion.qd)),
    "robot_mode": ("INT32", lambda c: c.shown_mode),
    "joint_mode": (
        "VECTOR6INT32",
        lambda c: [robot_states.joint_mode(c.shown_mode, c.safety_mode)] * 6,
    ),
    "safety_mode": ("INT32", lambda c: c.safety_mode),
    "safety_status": ("INT32", lambda c: c.safety_mode),
    # Of the trajectory limiter, which never intervenes here. Slider and pause are not in it.
    "speed_scaling": ("DOUBLE", lambda c: c.faked.get("speed_scaling", 1.0)),
    "target_speed_fraction": ("DOUBLE", lambda c: c.slider),
    "actual_robot_voltage": ("DOUBLE", lambda c: 48.0 if c.powered else 0.0),
    "actual_robot_current": ("DOUBLE", lambda c: 1.0 if c.powered else 0.0),
    "actual_joint_voltage": ("VECTOR6D", lambda c: [48.0 if c.powered else 0.0] * 6),
    "actual_digital_output_bits": ("UINT64", lambda c: c.digital_outputs),
    "runtime_state": ("UINT32", lambda c: c.runtime),
    "elbow_position": ("VECTOR3D", lambda c: c.elbow()),
    "robot_status_bits": (
        "UINT32",
        lambda c: robot_states.robot_status_bits(c.powered, c.program_runs, c.guided),
    ),
    "safety_status_bits": ("UINT32", lambda c: robot_states.safety_status_bits(c.safety_mode)),
    "tool_mode": ("UINT32", lambda c: 253 if c.shown_mode == RobotMode.RUNNING else 255),
    "tcp_force_scalar": ("DOUBLE", lambda c: sum(f * f for f in c.wrench[:3]) ** 0.5),
    "output_bit_registers0_to_31": ("UINT32", lambda c: _bits(c.outputs["bit"], 0)),
    "output_bit_registers32_to_63": ("UINT32", lambda c: _bits(c.outputs["bit"], 32)),
    "input_bit_registers0_to_31": ("UINT32", lambda c: _bits(c.inputs["bit"], 0)),
    "input_bit_registers32_to_63": ("UINT32", lambda c: _bits(c.inputs["bit"], 32)),
    "payload": ("DOUBLE", lambda c: c.payload),
    "payload_cog": ("VECTOR3D", lambda c: c.payload_cog),
    "script_control_line": ("UINT32", lambda c: c.program_line),
    "ft_raw_wrench": ("VECTOR6D", lambda c: c.wrench),
    "tcp_offset": ("VECTOR6D", lambda c: c.tcp_offset),
    "actual_configurable_digital_output_bits": ("UINT64", lambda c: c.digital_outputs >> 8),
    "control_step": ("UINT64", lambda c: c.cycles),
}
"""What a client may ask for: name -> type, value."""

_CONSTANT: dict[tuple[str, float | tuple[float, ...]], str] = {
    ("DOUBLE", 0.0): "actual_momentum standard_analog_input0 standard_analog_input1 io_current "
    "standard_analog_output0 standard_analog_output1 tool_analog_input0 tool_analog_input1 "
    "tool_output_current joint_position_deviation_ratio collision_detection_ratio "
    "actual_robot_energy_consumed actual_robot_braking_energy_dissipated euromap67_24V_voltage "
    "euromap67_24V_current",
    ("DOUBLE", 0.2): "actual_execution_time target_execution_time",
    ("DOUBLE", 28.0): "tool_temperature",
    ("DOUBLE", 48.0): "actual_main_voltage",
    ("VECTOR6D", 0.0): "target_current target_moment actual_current joint_control_output "
    "payload_inertia actual_current_as_torque actual_TCP_acceleration target_TCP_acceleration "
    "wrench_calc_from_currents target_base_acceleration target_base_wrench",
    ("VECTOR6D", 1.0): "actual_current_window",
    ("VECTOR6D", 28.0): "joint_temperatures",
    ("VECTOR3D", 0.0): "elbow_velocity",
    ("VECTOR3D", (0.0, 0.0, -9.82)): "actual_tool_accelerometer",
    ("VECTOR3D", (0.0, 0.0, 9.82)): "target_gravity",
    ("INT32", -1): "time_scale_source",
    ("INT32", 0): "tool_output_voltage encoder0_raw encoder1_raw",
    ("UINT32", 0): "analog_io_types tool_analog_input_types euromap67_input_bits "
    "euromap67_output_bits",
    ("UINT64", 0): "actual_digital_input_bits actual_configurable_digital_input_bits",
    ("UINT8", 0): "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
}
"""Type and value -> outputs that always have it, each element of a vector."""

INPUTS = {
    name: code
    for code, names in {
        "UINT32": "speed_slider_mask input_bit_registers0_to_31 input_bit_registers32_to_63",
        "DOUBLE": "speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
        "UINT8": "standard_digital_output_mask standard_digital_output "
        "configurable_digital_output_mask configurable_digital_output tool_digital_output_mask "
        "tool_digital_output standard_analog_output_mask standard_analog_output_type",
        "VECTOR6D": "external_force_torque",
    }.items()
    for name in names.split()
}
"""What a client may set: name -> type."""


def _bits(registers: Sequence[bool], first: int) -> int:
    return sum(bool(bit) << place for place, bit in enumerate(registers[first : first + 32]))


def _register(side: str, kind: str, number: int) -> Get:
    return lambda controller: getattr(controller, side)[kind][number]


def _always(code: str, value: float | tuple[float, ...]) -> Get:
    count = COUNT[code]
    found = [value] * count if count > 1 and not isinstance(value, tuple) else value
    return lambda controller: found


for (_code, _value), _names in _CONSTANT.items():
    OUTPUTS |= {name: (_code, _always(_code, _value)) for name in _names.split()}
for _kind, (_count, _code) in REGISTERS.items():
    for _number in range(_count):
        if _kind != "bit" or _number >= 64:
            INPUTS[f"input_{_kind}_register_{_number}"] = _code
        for _side in ("input", "output"):
            _name = f"{_side}_{_kind}_register_{_number}"
            OUTPUTS[_name] = (_code, _register(f"{_side}s", _kind, _number))
