"""Remote-centre-of-motion control as a library: controller, kinematics, limits, cell files. No ROS.

The names that users need from the C++ core (``surg_core._core``) and from the file readers.
``surg_core.calibration`` solves calibrations.
"""

# One list for each module, in which every name is exported.
# isort: skip_file
import pkgutil

# In a workspace the compiled half lies in the devel space, and whoever inherits the path of a
# process that has imported us (a spawned child) finds this folder first.
__path__ = pkgutil.extend_path(__path__, __name__)

from surg_core._core import (
    ArmShape as ArmShape,
)
from surg_core.clearance import clearance_setup as clearance_setup
from surg_core.config import (
    Arm as Arm,
    Cell as Cell,
    kinematics_of as kinematics_of,
    load_cell as load_cell,
    load_instrument as load_instrument,
    load_kinematics as load_kinematics,
    load_robot as load_robot,
    load_tool as load_tool,
    load_trocar as load_trocar,
    read_document as read_document,
)
from surg_core.transforms import (
    axis_angle_to_matrix as axis_angle_to_matrix,
    inverse_pose as inverse_pose,
    make_pose as make_pose,
    matrix_to_quaternion_xyzw as matrix_to_quaternion_xyzw,
    matrix_to_rpy as matrix_to_rpy,
    quaternion_xyzw_to_matrix as quaternion_xyzw_to_matrix,
    rpy_to_matrix as rpy_to_matrix,
    tip_quaternion as tip_quaternion,
)
from surg_core.urdf import (
    chain_from_urdf as chain_from_urdf,
    fixed_transform as fixed_transform,
    load_chain as load_chain,
    load_urdf as load_urdf,
)
