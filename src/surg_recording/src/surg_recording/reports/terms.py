"""The terms of all reports, defined once."""

from __future__ import annotations

NAMES = {
    "phantom": "phantom",
    "ex_vivo": "ex vivo",
    "in_vivo": "in vivo",
    "bgr": "Bowel grasping and retraction",
    "endoscope_guidance": "Endoscope guidance",
    "needle_driving": "Needle driving",
    "thread_in_hole": "Thread in hole",
    "pick_and_place": "Peg transfer",
    "ur3e": "UR3e",
    "ur5e": "UR5e",
    "ur10e": "UR10e",
    "panda": "Panda",
    "fr3": "FR3",
    "teleop": "Teleoperation",
    "bundled": "The bundled hand motion",
}
"""Identifier -> its name in figures and titles; others show as they are."""


def named(identifier: object) -> str:
    """The name of an identifier; of a path of a task or a motion, that of its file."""
    words = str(identifier)
    if words.endswith((".py", ".csv")):
        words = words.rpartition("/")[2].rpartition(".")[0]
    return NAMES.get(words, words)


TERMS = {
    "Window": "All values are measured from the first to the last control cycle that followed a"
    " servo command stream.",
    "Condition": "Episodes with the same task, setting, robot, control law and source (simulation"
    " or real). A label names what tells the conditions apart.",
    "Success": "By the task's definition, from the simulator's ground truth"
    " (docs/reference/tasks.md). An episode that ends for any other reason is a failure; the table"
    " names the reason.",
    "95 % interval": "Wilson's score interval of the success rate over all seeds.",
    "Kinematic RCM deviation": "Distance from the commanded pivot to the infinite shaft line,"
    " computed from joint states and calibration at every cycle of the window. This is the paper's"
    " metric; it does not include calibration errors.",
    "True RCM deviation": "Distance from the unloaded trocar point, which moves with breathing, to"
    " the simulator's shaft axis.",
    "Bound": "Reference value of the setting, for information. The parameters of the settings were"
    " fixed before any deviation was evaluated.",
    "Tip error": "Distance between the executed tip (the simulator's ground truth; without a"
    " simulator, the measured tip) and the input, shifted by the constant lag that minimises its"
    " rms. The lag is a value of its own.",
    "Path length": "Length of the tip paths after a low-pass at 3 Hz (zero-phase Butterworth, order"
    " 4), which removes tremor.",
    "Idle time": "Pauses of at least 0.5 s in which the executed tip, after the same low-pass,"
    " stays below 1 mm/s.",
    "Shaft sweep": "The largest angle between any two shaft directions of the run.",
    "Unscaled": "Cycles in which no limit slowed the motion (limit factor 1).",
    "SPARC, LDLJ": "Spectral arc length and log dimensionless jerk of the executed tip at 5 Hz;"
    " closer to zero is smoother. docs/guide/evaluation.md has the formulas. Do not compare values"
    " of different presets.",
    "Median [quartiles], interval": "Over the episodes. The 95 % interval of the median is between"
    " two of the values (order statistics, no distribution assumed) and needs 6 of them.",
    "Trocar displacement": "Distance of the trocar point under load from its unloaded position.",
    "State hash": "SHA-256 over the simulator's positions and velocities after every tick. Two"
    " lock-step runs with the same seed have the same hash.",
}
