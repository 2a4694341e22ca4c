// What a message becomes before the controller sees it, and what the controller's cycle becomes
// before it is a message again: plain values that may cross threads.
#pragma once

#include <array>
#include <cstdint>
#include <limits>

#include "surg_core/controller.hpp"

namespace surg_control {

/// The control period, one tick: 2 ms. Lock-step stamps are whole multiples of it.
constexpr std::uint64_t kTickNs = 2'000'000;
constexpr double kTick = 0.002;  ///< [s]

/// One decoded command of any kind.
struct CommandItem {
  enum class Kind : std::uint8_t { kState, kSetRcm, kMotion };
  Kind kind = Kind::kMotion;
  std::uint32_t source = 0;                                 ///< id of the sender in a SourceTable
  surg::StateCommand state = surg::StateCommand::kDisable;  ///< kState
  surg::Vector3 p_BRcm = surg::Vector3::Zero();             ///< kSetRcm
  surg::MotionCommand motion;                               ///< kMotion
  /// servo_cv: the whole angular velocity in the rcm frame; its part along the shaft becomes
  /// roll_rate in the cycle that knows the shaft.
  surg::Vector3 angular = surg::Vector3::Zero();
};

/// What the robot link and the tool link last said.
struct LinkState {
  std::uint64_t stamp_ns = 0;    ///< header stamp; 0: nothing received yet
  std::int64_t received_ns = 0;  ///< steady clock
  surg::JointVector q, qd;
  double jaw = std::numeric_limits<double>::quiet_NaN();  ///< until the tool link has spoken
};

/// What became of a state command or a taught trocar.
struct Answer {
  CommandItem::Kind kind = CommandItem::Kind::kState;
  surg::StateCommand state = surg::StateCommand::kDisable;
  surg::Reason reason = surg::Reason::kNone;  ///< kNone: done
  std::uint32_t source = 0;
};

/// One control cycle, complete: every outgoing topic is made from this.
struct CycleRecord {
  std::uint64_t stamp_ns = 0;  ///< of the joint state used; 0: there was none
  std::uint64_t tick = 0;
  surg::JointVector q, qd;
  surg::Outputs out;
  surg::Pose X_BR = surg::Pose::Identity();
  Eigen::Quaterniond q_RTool = Eigen::Quaterniond::Identity();  ///< measured
  Eigen::Quaterniond q_RSet = Eigen::Quaterniond::Identity();
  Eigen::Quaterniond q_RGoal = Eigen::Quaterniond::Identity();
  int n_answers = 0;
  std::array<Answer, surg::kMaxCommands> answers;
  double compute_us = 0;
  double period_us = 0;
  std::uint32_t overruns = 0;
  std::uint32_t refused_by_node = 0;  ///< commands that never reached the controller
};

}  // namespace surg_control
