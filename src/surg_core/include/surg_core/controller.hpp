// One arm's controller: step() runs gate, set-point, law, limits and last check in that order
// (docs/architecture.md). Pure: time and sender ids are arguments. No allocation, lock or I/O.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>

#include "surg_core/config.hpp"
#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/kinematics/trocar.hpp"
#include "surg_core/law/rcm.hpp"
#include "surg_core/limits/clearance.hpp"
#include "surg_core/limits/fixtures.hpp"
#include "surg_core/limits/stop_bound.hpp"
#include "surg_core/motion/command.hpp"
#include "surg_core/state/force_guard.hpp"
#include "surg_core/state/operating_state.hpp"
#include "surg_core/state/robot_condition.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// The controller's answer to a command.
struct Verdict {
  Reason reason = Reason::kNone;  ///< kNone: accepted
  std::uint32_t source = 0;
  Motion motion = Motion::kNone;
};

constexpr int kMaxCommands = 64;  ///< of one cycle; the node keeps the rest for the next one

/// Latest measurements of arm, tool and sensors, and the time since the last cycle.
struct Readings {
  /// [s] since the last cycle on the steady clock; 0: exactly one control period (lock-step).
  double elapsed = 0;
  bool state_valid = false;  ///< q, qd hold a joint state
  double state_age = 0;      ///< [s] since it was received (0 in lock-step)
  JointVector q, qd;         ///< measured [rad, rad/s]
  RobotCondition condition = RobotCondition::kActive;  ///< F33, as the robot link says
  double condition_age = 0;  ///< [s] since it was received (0 in lock-step)
  double jaw = 0;            ///< measured jaw [rad]
  double jaw_age = 0;        ///< [s] since it was received (0 in lock-step)
  /// Measured joints of the wrist's drive [rad] and their rates [rad/s], of the jaw's age.
  DriveJoints wrist = DriveJoints::Zero(), wrist_rate = DriveJoints::Zero();
  ForceSample tip_force;     ///< F25, where a sensor exists
  ForceSample trocar_force;  ///< load of the trocar
  // rcm/track, where Options::track_rcm is set:
  bool track_valid = false;            ///< a sample has been received
  double track_age = 0;                ///< [s] since it was taken
  Vector3 p_BTrack = Vector3::Zero();  ///< where the trocar was then
  Vector3 v_BTrack = Vector3::Zero();  ///< [m/s]; zeros where the tracker measures none
  OtherArms others;                    ///< in the order of ClearanceSetup::others
};

/// Inputs of one cycle.
struct Inputs : Readings {
  int n_commands = 0;
  std::array<MotionCommand, kMaxCommands> commands;
};

/// The wrist in one cycle. Rotations are in the rcm frame.
struct WristOutputs {
  bool exists = false;
  WristGeometry geometry;  ///< its turn is known from home on
  WristJoints q = WristJoints::Zero(), qd = WristJoints::Zero();  ///< measured
  WristJoints set = WristJoints::Zero(), goal = WristJoints::Zero();
  /// For the drive [rad], so that it is where the arm is; not finite: unknown, nothing is sent.
  DriveJoints command = DriveJoints::Zero();
  Matrix3 R_RTip = Matrix3::Identity(), R_RSet = Matrix3::Identity();
  Matrix3 R_RGoal = Matrix3::Identity();
  Vector3 omega_B = Vector3::Zero();  ///< measured, of the tip [rad/s]
};

/// Outputs of one cycle: the source of the robot command and of surg_msgs/Cycle.
struct Outputs {
  State state = State::kDisabled;
  Reason reason = Reason::kNone;  ///< why PAUSED, FAULT, or why held
  bool homed = false, busy = false;
  Motion motion = Motion::kNone;  ///< obeyed in this cycle
  std::uint32_t source = 0;       ///< its sender
  std::uint32_t accepted = 0, refused = 0;
  int n_verdicts = 0;
  std::array<Verdict, kMaxCommands> verdicts;  ///< one per command of this cycle, in order
  bool warn_force = false;                     ///< load of the trocar above the warn level
  bool warn_rcm = false;                       ///< rcm error above the warn level
  /// [s] of the link, measured from the motion so far; NaN: not enough motion yet
  double link_lag = std::numeric_limits<double>::quiet_NaN();
  JointVector joint_lag;  ///< [s] the same of each joint; empty before the first motion
  TrackWarning warn_track = TrackWarning::kNone;
  WristOutputs wrist;  ///< where there is one, the tip below is behind it
  // geometry, in B
  Pose X_BF = Pose::Identity();
  Vector3 p_BTip = Vector3::Zero(), s_B = Vector3::UnitZ(), p_BRcm = Vector3::Zero();
  Vector3 v_BTip = Vector3::Zero();  ///< measured tip velocity
  double roll = 0, depth = 0, rcm_error = 0;
  Vector4 virtual_q = Vector4::Zero();   ///< measured yaw, pitch, insertion, roll
  Vector4 virtual_qd = Vector4::Zero();  ///< their measured rates
  Vector4 virtual_set = Vector4::Zero();
  // set-point and goal, in B
  Vector3 p_goal = Vector3::Zero(), p_set = Vector3::Zero(), v_set = Vector3::Zero();
  double roll_goal = 0, roll_set = 0;
  double jaw_set = 0, jaw = 0;
  /// [rad] swivel angle that the elbow shall have; NaN: none
  double elbow_goal = std::numeric_limits<double>::quiet_NaN();
  /// Joint whose limit holds the elbow away from its goal or refused its command; the number of
  /// joints: a singularity or an undefined angle; -1: nothing
  int elbow_limit = -1;
  // output
  double scale = 1;             ///< alpha
  const char* limited_by = "";  ///< static string
  std::uint8_t tier = 0;        ///< 0: on the path, 1: off it, on the pivot; 2: braking
  /// [m] smallest distance to the other arms and the obstacles; infinite without a guard
  double clearance = std::numeric_limits<double>::infinity();
  StopBound stop_bound;   ///< not a number without a joint state
  double late_share = 0;  ///< of the last 128 cycles, how many were late
  /// The link shall get no command: it stops the arm by itself, sooner than rare commands would.
  bool withheld = false;
  JointVector qd_command;  ///< [rad/s]
  Vector6 twist_command = Vector6::Zero();
};

/// kExact: a virtual reference on the exact constraint, which the arm is made to follow; for links
/// that take joint velocities (default). kVelocity: velocity form with feedback; for links that
/// take a flange twist. kPaper: the paper's equations as printed, open loop.
enum class Law { kVelocity, kPaper, kExact };

/// One arm's controller. Construct once (may allocate), then call step() every dt.
class Controller {
 public:
  struct Options {
    Law law = Law::kExact;
    double dt = 0.002;          ///< [s] control period
    double feedback_gain = -1;  ///< [1/s] overrides tuning.rcm_gain when >= 0; simulator only
    bool track_rcm = false;     ///< the trocar may move: Inputs::p_BTrack
  };
  Controller(const Chain& chain, const RobotConfig& robot, const Limits& limits,
             const InstrumentConfig& instrument, const ToolCalibration& tool,
             const Options& options, const ClearanceSetup& clearance = {});
  ~Controller();

  /// Requests a state transition, effective at once, from the joint state of the last step. kNone:
  /// done.
  Reason request(StateCommand command);
  /// Sets the trocar point in B; only in DISABLED or PAUSED (F23), and at rest.
  Reason set_rcm(const Vector3& p_BRcm);
  /// Adds a region in B, or replaces the one of its name. A region may be added at any time; one
  /// that exists may be replaced or removed only while not ENABLED, one of the cell never.
  Reason set_fixture(const Fixture& fixture);
  Reason remove_fixture(std::string_view name);
  const Fixtures& fixtures() const;  ///< in B
  /// Changes instrument and calibration; only in DISABLED and at rest. The trocar point stays;
  /// home, trace and targets do not. Never allocates.
  Reason change_tool(const InstrumentConfig& instrument, const ToolCalibration& tool);
  /// Enters FAULT for an external reason (node: overrun and the like).
  void fault(Reason reason);
  void pause(Reason reason);
  /// Gives 'source' exclusive authority until the arm leaves ENABLED. Refused while another source
  /// holds the arm.
  Reason claim(std::uint32_t source);

  /// Runs one control cycle. Never throws, never allocates.
  const Outputs& step(const Inputs& inputs);

  /// X_BR: the rcm frame (origin trocar, z home shaft axis into the patient, x = base x made
  /// perpendicular to z). Commands and measured_cp are in it. Identity rotation until homed.
  const Pose& X_BR() const;
  /// R_RTool for a shaft direction and roll, the orientation in measured_cp: the minimal rotation
  /// from z to the shaft, after the roll about z; identity at home.
  Eigen::Quaterniond tool_orientation(const Vector3& s_B, double roll) const;
  bool rcm_set() const;
  double dt() const;

  /// Writes a snapshot of everything that the next steps depend on, for the black box. Returns the
  /// size needed; the content is useless where 'room' is less. Never allocates.
  std::size_t save(std::byte* to, std::size_t room) const;
  /// Restores a snapshot into a controller of the same configuration, which then continues bit for
  /// bit. Returns false and changes nothing for a snapshot of another build.
  bool restore(const std::byte* from, std::size_t size);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace surg
