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
    CalibrationError as CalibrationError,
    CellArm as CellArm,
    CellClearance as CellClearance,
    CellHardware as CellHardware,
    Chain as Chain,
    ClearanceSetup as ClearanceSetup,
    ConfigError as ConfigError,
    Controller as Controller,
    Fixture as Fixture,
    ForceSample as ForceSample,
    InstrumentConfig as InstrumentConfig,
    Law as Law,
    Limits as Limits,
    LinkCapsule as LinkCapsule,
    Motion as Motion,
    MotionCommand as MotionCommand,
    Obstacle as Obstacle,
    OtherArm as OtherArm,
    Outputs as Outputs,
    Readings as Readings,
    Reason as Reason,
    RobotCondition as RobotCondition,
    RobotConfig as RobotConfig,
    ShaftState as ShaftState,
    ShaftStates as ShaftStates,
    State as State,
    StateCommand as StateCommand,
    ToolCalibration as ToolCalibration,
    TrocarCalibration as TrocarCalibration,
    UrKinematics as UrKinematics,
    Verdict as Verdict,
    WristConfig as WristConfig,
    WristGeometry as WristGeometry,
    WristOutputs as WristOutputs,
    chain_from_urdf as chain_from_urdf,
    check_step as check_step,
    check_wrist_step as check_wrist_step,
    condition_sentence as condition_sentence,
    fixed_transform as fixed_transform,
    inside_workspace as inside_workspace,
    kinematics_of as kinematics_of,
    load_chain as load_chain,
    load_instrument as load_instrument,
    load_kinematics as load_kinematics,
    load_robot as load_robot,
    load_tool as load_tool,
    load_trocar as load_trocar,
    load_urdf as load_urdf,
    outside_workspace as outside_workspace,
    rcm_frame as rcm_frame,
    read_document as read_document,
    reason_name as reason_name,
    sentence as sentence,
    shaft_angles as shaft_angles,
    shaft_direction as shaft_direction,
    shaft_state as shaft_state,
    shaft_states as shaft_states,
    tip_of_wrist as tip_of_wrist,
    with_kinematics as with_kinematics,
    wrists_of_tip as wrists_of_tip,
)
from surg_core.clearance import clearance_setup as clearance_setup
from surg_core.config import Arm as Arm, Cell as Cell, load_cell as load_cell
from surg_core.transforms import (
    axis_angle_to_matrix as axis_angle_to_matrix,
    inverse_pose as inverse_pose,
    make_pose as make_pose,
    matrix_to_quaternion_xyzw as matrix_to_quaternion_xyzw,
    quaternion_xyzw_to_matrix as quaternion_xyzw_to_matrix,
    rpy_to_matrix as rpy_to_matrix,
    tip_quaternion as tip_quaternion,
)
