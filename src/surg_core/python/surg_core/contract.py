"""What the packages agree on: control period, 20 Hz grid, columns of states and actions.

A value stands here when two packages must use the same one: simulator, controller, recorder,
teleoperation and policy bridge meet on topics and in files, and none of them can change it alone.
``surg_policy_client``, which installs without anything else of this workspace, keeps a copy of the
keys; ``tests/unit/core/test_core_contract.py`` holds the two equal.
"""

from __future__ import annotations

from surg_core._core import Motion, State

SECOND_NS = 1_000_000_000
"""One second [ns]."""

# --- time --------------------------------------------------------------------------------------

TICK = 0.002
"""Control period [s]: one cycle of a controller and one tick of the simulator (500 Hz)."""
TICK_NS = 2_000_000
"""Control period [ns]. A command answers a cycle and is meant for the next one."""
GRID = 25
"""Ticks between two observations, two actions and two camera images: 20 Hz."""
STEP = GRID * TICK
"""Period of the grid [s]: one step of an environment or a policy."""
STEP_NS = GRID * TICK_NS
"""Period of the grid [ns]."""
GRID_RATE = SECOND_NS // STEP_NS
"""Steps and images per second."""
PRESENCE_TIMEOUT = 0.25
"""Age at which a held pedal or an operator's presence expires [s]; both repeat at 20 Hz."""

# --- states and actions (docs/reference/tasks.md) ------------------------------------------------

VIRTUAL_JOINTS = ("yaw", "pitch", "insertion", "roll")
"""Joints of an arm on its trocar, as every topic and file orders them [rad, rad, m, rad]."""
WRISTED_JOINTS = (*VIRTUAL_JOINTS, "wrist_pitch", "wrist_yaw")
"""The same of an arm whose instrument has a wrist; what it adds is in rad."""
ARM_ACTION = ("x", "y", "z", "roll", "jaw")
"""Action of each commanded arm: tip, roll and jaw at the next grid time, in the rcm frame."""
ARM_ACTION_UNITS = ("m", "m", "m", "rad", "rad")
ACTION_SPACES = {
    "absolute": dict(zip(ARM_ACTION, ARM_ACTION_UNITS, strict=True)),
    "relative": {"dx": "m", "dy": "m", "dz": "m", "droll": "rad", "jaw": "rad"},
    "velocity": {"vx": "m/s", "vy": "m/s", "vz": "m/s", "vroll": "rad/s", "jaw": "rad"},
    "joint": {"yaw": "rad", "pitch": "rad", "insertion": "m", "roll": "rad", "jaw": "rad"},
}
"""Columns and units of an arm's action, by action space (``surg_core.action_space``)."""
WRISTED_ACTION_SPACES = {
    "absolute": {
        **dict.fromkeys(("x", "y", "z"), "m"),
        **dict.fromkeys(("qx", "qy", "qz", "qw"), "1"),
        "jaw": "rad",
    },
    "relative": {
        **dict.fromkeys(("dx", "dy", "dz"), "m"),
        **dict.fromkeys(("drx", "dry", "drz", "jaw"), "rad"),
    },
    "velocity": {
        **dict.fromkeys(("vx", "vy", "vz"), "m/s"),
        **dict.fromkeys(("wx", "wy", "wz"), "rad/s"),
        "jaw": "rad",
    },
    "joint": {
        **dict.fromkeys(WRISTED_JOINTS, "rad"),
        "insertion": "m",
        "jaw": "rad",
    },
}
"""The same of an arm whose instrument has a wrist."""
ARM_STATE = (
    *("tip_x", "tip_y", "tip_z", "roll", "jaw"),
    *("set_x", "set_y", "set_z", "roll_set"),
)
"""State of each arm, in the rcm frame: measured tip, roll and jaw; tip and roll to go on from.

A sender goes on from the newest accepted sample of a stream of positions: the set-point runs ahead
of it, and steps from there would swing. Otherwise it goes on from the set-point.
"""
ARM_STATE_UNITS = ("m", "m", "m", "rad", "rad", "m", "m", "m", "rad")
WRISTED_STATE = (
    *("tip_x", "tip_y", "tip_z", "tip_qx", "tip_qy", "tip_qz", "tip_qw"),
    *(*WRISTED_JOINTS, "jaw"),
    *("set_x", "set_y", "set_z", "set_qx", "set_qy", "set_qz", "set_qw"),
    *(f"{name}_set" for name in WRISTED_JOINTS),
)
"""The same behind a wrist: pose of the tip and the six joints, measured and to go on from."""
_POSE_AND_JOINTS = (
    *("m", "m", "m", "1", "1", "1", "1"),
    *("rad", "rad", "m", "rad", "rad", "rad"),
)
WRISTED_STATE_UNITS = (*_POSE_AND_JOINTS, "rad", *_POSE_AND_JOINTS)


def arm_state(wristed: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of an arm's state."""
    if wristed:
        return WRISTED_STATE, WRISTED_STATE_UNITS
    return ARM_STATE, ARM_STATE_UNITS


ARM_FORCE = (
    *("tip_x", "tip_y", "tip_z", "tip_known"),
    *("trocar_x", "trocar_y", "trocar_z", "trocar_known"),
)
"""Forces on each arm's tip and on its trocar, in the rcm frame; ``known`` is 1, or 0 with zeros."""
ARM_FORCE_UNITS = ("N", "N", "N", "1", "N", "N", "N", "1")
FORCE_TICKS = 5
"""In lock-step forces are measured on every fifth tick; they count from the next cycle on."""
FORCE_TIMEOUT_NS = 200_000_000
"""Age at which a measured force is no longer known [ns], as for the controller's guard."""

STATE_KEY = "observation.state"
FORCE_KEY = "observation.force"
ACTION_KEY = "action"
TASK_STATE_KEY = "privileged.task_state"
IMAGE_PREFIX = "observation.images."
"""Keys of datasets and of the policy wire (docs/reference/datasets.md)."""


def image_key(camera: str) -> str:
    """Key of a camera: ``endoscope_left`` is ``observation.images.endoscope.left``."""
    stem, _, side = camera.rpartition("_")
    return IMAGE_PREFIX + (f"{stem}.{side}" if stem and side in ("left", "right") else camera)


# --- numbers of surg_msgs/Cycle ------------------------------------------------------------------

STATE_NAMES = tuple(State.__members__)
"""CRTK operating states; a state's number is its index."""
DISABLED, ENABLED, PAUSED, FAULT = (int(State.__members__[name]) for name in STATE_NAMES)
POSITION_STREAMS = tuple(int(m) for m in (Motion.SERVO_CP, Motion.SERVO_JP, Motion.SERVO_JR))
"""``Cycle.command`` of streams whose samples are positions: a sample may be a step too far."""
STREAMS = tuple(sorted({*POSITION_STREAMS, int(Motion.SERVO_CV), int(Motion.SERVO_JV)}))
"""``Cycle.command`` of all streams."""
