// Plain values between messages and controller that may cross threads: decoded commands, link
// state, and the record of a cycle.
#pragma once

#include <array>
#include <cstdint>
#include <limits>

#include "surg_control/topics/base_frame.hpp"
#include "surg_core/controller.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {

/// The control period, one tick: 2 ms. Lock-step stamps are whole multiples of it.
constexpr std::uint64_t kTickNs = 2'000'000;
constexpr double kTick = 0.002;  ///< [s]

/// One decoded command of any kind. Within one cycle the kinds take effect in the order below.
struct CommandItem {
  enum class Kind : std::uint8_t {
    kState,
    kTool,
    kSetRcm,
    kSetFixture,
    kRemoveFixture,
    kSetFrame,
    kClaim,
    kAtWall,
    kTrack,
    kMotion
  };
  Kind kind = Kind::kMotion;
  std::uint32_t source = 0;                                 ///< id of the sender in a SourceTable
  surg::StateCommand state = surg::StateCommand::kDisable;  ///< kState
  surg::Vector3 p_B = surg::Vector3::Zero();                ///< kSetRcm, kTrack: the trocar [m]
  surg::Vector3 v_B = surg::Vector3::Zero();                ///< kTrack [m/s]
  std::uint64_t stamp_ns = 0;                               ///< of the message; 0: none
  std::int64_t received_ns = 0;  ///< kTrack: steady clock; 0: in the cycle that takes it
  FrameName frame;               ///< kMotion: header.frame_id; kSetFrame: name of U
  surg::Pose X_UR = surg::Pose::Identity();  ///< kSetFrame
  bool slide = false;                        ///< kAtWall
  surg::Fixture fixture;                     ///< kSetFixture, in B; kRemoveFixture: its name
  const surg::MountedTool* tool = nullptr;   ///< kTool; lives as long as the node
  surg::MotionCommand motion;  ///< kMotion; poses and twists still in 'frame', not in R
  /// servo_cv: the complete angular velocity. The cycle projects it onto the shaft to get
  /// roll_rate, unless there is a wrist.
  surg::Vector3 angular = surg::Vector3::Zero();
};

/// A measured force; not every arm has a sensor.
struct MeasuredForce {
  surg::Vector3 f_B = surg::Vector3::Zero();  ///< of the environment on the instrument [N]
  std::int64_t received_ns = 0;               ///< 0: no sensor has spoken yet
};

/// Latest joint state of another arm of the cell.
struct OtherState {
  std::int64_t received_ns = 0;  ///< 0: none yet
  surg::JointVector q, qd;
};

/// Latest data of the robot link and the tool link. Times are on the steady clock, in lock-step of
/// the tick.
struct LinkState {
  std::uint64_t stamp_ns = 0;    ///< header stamp; 0: nothing received yet
  std::int64_t received_ns = 0;  ///< when q, qd came
  surg::JointVector q, qd;
  surg::RobotCondition condition = surg::RobotCondition::kOffline;  ///< F33
  std::int64_t condition_received_ns = 0;                 ///< when the link last said it; 0: never
  double jaw = std::numeric_limits<double>::quiet_NaN();  ///< until the tool link has spoken
  std::int64_t jaw_received_ns = 0;                       ///< when jaw came; 0: never
  surg::DriveJoints wrist =
      surg::DriveJoints::Constant(std::numeric_limits<double>::quiet_NaN());  ///< with the jaw
  surg::DriveJoints wrist_rate = surg::DriveJoints::Zero();
  MeasuredForce tip, trocar;                           ///< F25
  std::array<OtherState, surg::kMaxOtherArms> others;  ///< in the order of the clearance setup
};

/// Result of a command that the controller does not judge as a motion.
struct Answer {
  CommandItem::Kind kind = CommandItem::Kind::kState;
  surg::StateCommand state = surg::StateCommand::kDisable;
  surg::Motion motion = surg::Motion::kNone;  ///< kMotion: refused before the controller saw it
  surg::Reason reason = surg::Reason::kNone;  ///< kNone: done
  std::uint32_t source = 0;
  bool slide = false;  ///< kAtWall
};

/// An accepted command with a part that four degrees of freedom cannot follow.
struct Ignored {
  surg::Motion motion = surg::Motion::kNone;  ///< kNone: nothing was ignored in this cycle
  std::uint32_t source = 0;
};

/// Record of one control cycle, from which every outgoing topic is made.
struct CycleRecord {
  std::uint64_t stamp_ns = 0;  ///< of the joint state used; 0: there was none
  std::uint64_t tick = 0;
  surg::JointVector q, qd;
  surg::Outputs out;
  surg::Pose X_BR = surg::Pose::Identity();
  Eigen::Quaterniond q_RTool = Eigen::Quaterniond::Identity();  ///< measured
  Eigen::Quaterniond q_RSet = Eigen::Quaterniond::Identity();
  Eigen::Quaterniond q_RGoal = Eigen::Quaterniond::Identity();
  const surg::MountedTool* tool = nullptr;  ///< mounted now; null: as at the start
  BaseFrame frame;                          ///< of commands and measured_cp
  surg::Fixtures fixtures;                  ///< in B
  std::uint32_t fixtures_version = 0;       ///< counts their changes
  FrameName wrong_frame;                    ///< the last frame_id that was refused
  Ignored orientation;                      ///< of a pose: all but the roll about the shaft
  Ignored angular;                          ///< of a twist: all but the part along the shaft
  int n_answers = 0;
  std::array<Answer, surg::kMaxCommands> answers;
  double compute_us = 0;
  double period_us = 0;
  std::uint32_t overruns = 0;
  std::uint32_t refused_by_node = 0;   ///< commands that never reached the cycle
  std::uint32_t refused_by_cycle = 0;  ///< motions that the cycle kept from the controller
  /// Commands so far that clients wait for by is_busy: moves and home, refused ones included.
  std::uint32_t moves = 0;
  std::uint32_t moves_refused_by_node = 0;  ///< moves among refused_by_node
};

/// What a cycle tells robot and tool.
struct LinkCommand {
  std::uint64_t stamp_ns = 0;  ///< of the joint state used; 0: there was none, nothing is sent
  std::uint64_t tick = 0;
  surg::JointVector qd;                                 ///< [rad/s]
  surg::Vector6 twist = surg::Vector6::Zero();          ///< of the flange
  double jaw = 0;                                       ///< [rad]; not finite: unknown
  surg::DriveJoints wrist = surg::DriveJoints::Zero();  ///< [rad]; likewise
  const surg::MountedTool* tool = nullptr;              ///< as in CycleRecord

  static LinkCommand of(const CycleRecord& record) {
    return {record.stamp_ns,
            record.tick,
            record.out.qd_command,
            record.out.twist_command,
            record.out.jaw_set,
            record.out.wrist.command,
            record.tool};
  }
  /// Zero velocity; the jaw as it was.
  LinkCommand at_rest() const {
    LinkCommand still = *this;
    still.qd.setZero();
    still.twist.setZero();
    return still;
  }
};

}  // namespace surg_control
