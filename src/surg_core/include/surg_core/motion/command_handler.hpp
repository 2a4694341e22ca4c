// Turns accepted motion commands into set-points, and monitors streams and moves. Authority,
// finiteness and operating state have been checked before.
#pragma once

#include "surg_core/config.hpp"
#include "surg_core/motion/command.hpp"
#include "surg_core/motion/setpoint.hpp"
#include "surg_core/motion/wrist_motion.hpp"
#include "surg_core/state/operating_state.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Tip position, unit shaft direction and roll in the rcm frame. With a wrist the tip of the shaft
/// is the wrist centre, here and in the set-point.
struct TipPose {
  Vector3 p_RTip = Vector3::Zero();
  Vector3 s_R = Vector3::UnitZ();
  double roll = 0;
};

class CommandHandler {
 public:
  /// Behind a moving trocar no arm ever rests.
  static constexpr double kArriveWithin = 1.0;  ///< [s] after a way's end; then it is given up

  /// dt: control period [s]. paper: streams follow the paper's quintic.
  CommandHandler(const Limits& limits, const Tuning& tuning,
                 const std::optional<WristConfig>& wrist, double dt, bool paper);

  /// Starts at rest at the arm's position and drops all targets.
  void start(const TipPose& at);
  /// Decelerates and drops all targets.
  void stop();
  /// The regions from now on, in the rcm frame. A move whose way is no longer clear is stopped.
  void set_fixtures(const Fixtures& fixtures_R);
  const Fixtures& fixtures() const { return fixtures_R_; }
  /// 'hold': decelerates, and blocks streams until they pause.
  void hold();
  /// Takes a motion command other than hold and jaw commands. kNone: accepted.
  Reason accept(const MotionCommand& command);
  /// Call it once per cycle, after the commands. kStale: a silent stream has been stopped (F03).
  Reason check_timeout();
  /// Call it once per cycle, after the motion. kNotArrived: a move has been given up.
  Reason check_arrival(const TipPose& at);
  /// Call it once per cycle, after the motion. limited: a limit slowed this cycle. kNotArrived: a
  /// limit has held the set-point for so long that its target has been given up.
  Reason check_progress(bool limited);

  Setpoint& setpoint() { return setpoint_; }
  const Setpoint& setpoint() const { return setpoint_; }
  WristMotion& wrist() { return wrist_; }
  const WristMotion& wrist() const { return wrist_; }
  /// Another instrument, at rest.
  void mount(const std::optional<WristConfig>& wrist) { wrist_ = WristMotion(wrist, tuning_); }
  const Vector3& p_goal() const { return p_goal_; }  ///< in R
  double roll_goal() const { return roll_goal_; }
  bool busy() const { return move_active_ || retracing_; }
  /// The motion in progress; kNone at rest.
  Motion motion() const;
  /// Retracing the joint trace; meanwhile the set-point follows the arm.
  bool retracing() const { return retracing_; }
  void end_retrace() { retracing_ = false; }
  /// The stream's last sample was outside the workspace; its sender asked to slide along the wall.
  bool sliding() const { return sliding_ && setpoint_.mode() == Setpoint::Mode::kStream; }
  /// A fixture holds the set-point off its command.
  bool at_fixture() const;

 private:
  Reason apply(const MotionCommand& command);
  Reason take(const MotionCommand& command);
  Reason resolve_pose(MotionCommand& command) const;
  void resolve_twist(MotionCommand& command) const;
  void give_roll_to_drive(MotionCommand& command) const;
  void move_wrist(const MotionCommand& command);
  Reason stream(const MotionCommand& command);
  Reason move_to(Space space, const std::array<double, 4>& target);
  Reason move_along_shaft(Motion motion);
  bool targets_reachable(const Vector3& p_RTip) const;
  bool roll_reachable(double roll) const;
  Vector3 nearest_reachable(const Vector3& p_RTip) const;
  double requested_roll(const Vector3& p_RTip, const Eigen::Quaterniond& rotation) const;
  double drive_roll(const TipFrame& centre) const;
  Vector4 present_goal() const;
  DriveJoints present_wrist() const;
  void set_goal(const Vector3& p_RTip, double roll);

  Limits limits_;
  Tuning tuning_;
  double timeout_, dt_;
  Fixtures fixtures_R_;
  Setpoint setpoint_;
  WristMotion wrist_;
  Vector3 p_goal_ = Vector3::Zero();
  double roll_goal_ = 0;
  Vector4 joint_goal_ = Vector4::Zero();  // of the last accepted target
  struct Pose4 {
    Vector3 p = Vector3::Zero();
    double roll = 0;
    DriveJoints wrist = DriveJoints::Zero();
  };
  Pose4 newest_;                // accepted stream pose, before it slides along the wall
  bool newest_counts_ = false;  // it was accepted in this cycle
  Pose4 anchor_;                // the newest one of an earlier cycle: steps are judged from it
  double since_anchor_ = 0;     // [s]
  bool sliding_ = false;
  int silent_cycles_ = 0;  // since the last accepted servo command
  Motion motion_ = Motion::kNone;
  bool move_active_ = false;  // a move_* is on its way
  bool retracing_ = false;
  bool stream_blocked_ = false;
  double stream_silence_ = 0;  // [s] since 'hold', or since a servo command was refused for it
  double settle_time_ = 0;     // [s] since the profile of a move ended
  double held_ = 0;            // [s] that the set-point has been near the place below
  Vector3 p_held_ = Vector3::Zero();
  double roll_held_ = 0;
};

}  // namespace surg
