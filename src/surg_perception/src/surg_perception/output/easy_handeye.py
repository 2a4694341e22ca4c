"""The camera's pose for the ROS package ``easy_handeye``: its YAML, and a line for tf2_ros.

Keys: https://github.com/IFL-CAMP/easy_handeye, ``handeye_calibration.py`` (eye on hand: the pose of
``tracking_base_frame`` in ``robot_effector_frame``, [m] and a unit quaternion).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from surg_core.held_endoscope import LEFT
from surg_core.replace_file import exact_number, replace_file
from surg_core.transforms import FloatArray, matrix_to_quaternion_xyzw


def easy_handeye_text(arm: str, X_FV: FloatArray) -> str:
    """The YAML of a camera at X_FV (4, 4) [m] in the flange of an arm."""
    keys = ("x", "y", "z", "qx", "qy", "qz", "qw")
    values = [*X_FV[:3, 3], *matrix_to_quaternion_xyzw(X_FV[:3, :3])]
    numbers = [exact_number(float(value)) for value in values]
    line = " ".join(numbers)
    return (
        f"# rosrun tf2_ros static_transform_publisher {line} {arm}_flange {LEFT}\n"
        "parameters:\n"
        "  eye_on_hand: true\n"
        "  move_group: manipulator\n"
        "  move_group_namespace: /\n"
        f"  namespace: /{arm}_eye_on_hand/\n"
        f"  robot_base_frame: {arm}_base\n"
        f"  robot_effector_frame: {arm}_flange\n"
        f"  tracking_base_frame: {LEFT}\n"
        "  tracking_marker_frame: board\n"
        "transformation:\n" + "".join(f"  {k}: {n}\n" for k, n in zip(keys, numbers, strict=True))
    )


def write_easy_handeye(folder: Path, arm: str, X_FV: FloatArray) -> Path:
    """Write ``easy_handeye_<arm>.yaml``; the old file stays as ``.previous``.

    Copy it to ``~/.ros/easy_handeye/<arm>_eye_on_hand.yaml`` for that package's ``publish.launch``.
    """
    path = folder / f"easy_handeye_{arm}.yaml"
    replace_file(path, easy_handeye_text(arm, np.asarray(X_FV)), Path.read_text)
    return path
