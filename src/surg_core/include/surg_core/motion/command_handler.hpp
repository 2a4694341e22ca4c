// From commands to the set-point: what each motion command means, what a stream may do, and when a
// source has fallen silent. Authority, finiteness and operating state have been checked before.
#pragma once

#include "surg_core/config.hpp"
#include "surg_core/motion/command.hpp"
#include "surg_core/motion/setpoint.hpp"
#include "surg_core/state/operating_state.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Where the instrument is, in the rcm frame.
struct Whereabouts {
  Vector3 p_RTip = Vector3::Zero();
  Vector3 s_R = Vector3::UnitZ();
  double roll = 0;
};

class Pilot {
 public:
  /// dt: control period [s]. paper: streams go through the paper's quintic.
  Pilot(const Limits& limits, const Tuning& tuning, double dt, bool paper);

  /// Stands where the arm is; every target is gone.
  void start(const Whereabouts& at);
  /// Ramps down; every target is gone.
  void stop();
  /// 'hold': stops, and a stream must pause before it may go on.
  void hold();
  /// Motion commands other than hold and jaw. kNone: taken.
  Reason take(const MotionCommand& command);
  /// Once a cycle, after the commands. kStale where a stream has just been given up (F03).
  Reason watch();
  /// Once a cycle, after the motion. kNotArrived where a move has just been given up.
  Reason follow_arrival(const Whereabouts& at);

  Setpoint& setpoint() { return setpoint_; }
  const Setpoint& setpoint() const { return setpoint_; }
  const Vector3& p_goal() const { return p_goal_; }  ///< in R
  double roll_goal() const { return roll_goal_; }
  bool busy() const { return moving_to_ || retracing_; }
  /// The motion under way; kNone at rest.
  Motion motion() const;
  /// Going back along the joint trace; the set-point only follows the arm meanwhile.
  bool retracing() const { return retracing_; }
  void end_retrace() { retracing_ = false; }

 private:
  Reason go(const MotionCommand& command);
  Reason stream(const MotionCommand& command);
  Reason go_along(Motion motion);
  bool targets_reachable(const Vector3& p_RTip) const;
  double asked_roll(const Vector3& p_RTip, const Eigen::Quaterniond& rotation) const;
  Vector4 present_goal() const;
  void set_goal(const Vector3& p_RTip, double roll);

  Limits limits_;
  double timeout_, dt_;
  Setpoint setpoint_;
  Vector3 p_goal_ = Vector3::Zero();
  double roll_goal_ = 0;
  Vector4 joint_goal_ = Vector4::Zero();  // of the last accepted target
  double since_pose_ = 0;                 // [s] since the last accepted stream pose
  int silent_cycles_ = 0;                 // since the last accepted servo command
  Motion motion_ = Motion::kNone;
  bool moving_to_ = false;  // a move_* is on its way
  bool retracing_ = false;
  bool held_ = false;
  double stream_silence_ = 0;  // [s] since 'hold', or since a servo command was refused for it
  double settle_ = 0;          // [s] since the profile of a move ended
};

}  // namespace surg
