// The moving set-point: what the instrument shall do next, from whichever kind of command came
// last. Four degrees of freedom in the rcm frame: x, y, z, roll (Cartesian) or yaw, pitch,
// insertion, roll (spherical). A plain value: copy it, advance the copy, keep the one whose step
// the limits allow.
#pragma once

#include <array>

#include "surg_core/config.hpp"
#include "surg_core/motion/profiler.hpp"
#include "surg_core/motion/stream.hpp"
#include "surg_core/types.hpp"

namespace surg {

enum class Space { kCartesian, kSpherical };

/// Position and velocity of the four degrees of freedom in one space.
using Dofs = std::array<Kinematic, Profiler::kDof>;

/// The same tip motion in the other space; accelerations are dropped. The tip must be off the
/// trocar.
Dofs to_spherical(const Dofs& cartesian);
Dofs to_cartesian(const Dofs& spherical);

class Setpoint {
 public:
  enum class Mode { kRest, kStream, kVelocity, kProfile, kStopping };

  Setpoint() = default;
  /// paper: every stream goes through the paper's quintic of fixed duration, re-planned each cycle.
  /// stream_delay [s]: a stream is followed that much later, see StreamDelay; not with 'paper'.
  Setpoint(const Limits& limits, double profiler_duration, bool paper, double stream_delay = 0);

  /// Stands still at a tip position [m] in the rcm frame, the shaft along unit s_R, and a roll
  /// [rad].
  void reset(const Vector3& p_RTip, const Vector3& s_R, double roll);
  /// A sample of a pose stream (servo_cp, servo_jp).
  void follow(Space space, const std::array<double, 4>& target, double T);
  /// A velocity to hold (servo_cv, servo_jv).
  void drive(Space space, const std::array<double, 4>& rate);
  /// A discrete target (interpolate_*, move_*): quintic to rest there. Where its overshoot from the
  /// present motion would leave the workspace, the tip stops first. False, and nothing changed,
  /// where the way from rest leads out of the workspace as well.
  bool go_to(Space space, const std::array<double, 4>& target);
  /// Straight along the shaft to a depth [m], which may lie above the trocar, at no more than
  /// 'speed' [m/s]; the workspace does not count. From rest only.
  void go_along(const Vector3& s_R, double depth, double speed);
  /// Decelerates the tip along its present direction.
  void stop();

  /// Stands still where it is and starts anew from rest: a limit has brought the arm to a stop, and
  /// a velocity kept from before would hold it there for ever. The target stays.
  void stand();

  /// A stop and a velocity have no path to keep.
  bool has_no_path() const { return mode_ == Mode::kStopping || mode_ == Mode::kVelocity; }
  /// Then it goes on from where and how the tip really is: a change that is harder than the joints
  /// can follow would leave the tip behind.
  void slip(const Vector3& p_RTip, const Vector3& v_RTip);

  /// Unit direction of a push on the tip, zero for none: streams and velocities no longer move
  /// against it, and a profile that does is stopped (F25).
  void yield_to(const Vector3& push_R);

  /// Real time passes: stream samples get older, and their delay goes by.
  void elapse(double T);
  /// The set-point moves on by dt <= T of its own clock.
  void advance(double dt);

  /// Tip and roll: all that a look ahead needs, at its many points.
  struct Place {
    Vector3 p_RTip;
    double roll;
  };
  /// Where advance(dt) would lead.
  Place after(double dt) const;
  /// Where the set-point will be in t [s] of its own clock, as far as is known now: along its
  /// profile, and straight on where a stream or a velocity leads it. For looking ahead, not for
  /// moving.
  Place foreseen(double t) const;

  Mode mode() const { return mode_; }
  Space space() const { return space_; }
  /// Moves or rests along the shaft line (go_along): only depth and roll may change.
  bool axial() const { return axial_; }
  /// The workspace's wall has stopped the last advance.
  bool at_wall() const { return at_wall_; }
  Vector3 p_RTip() const;
  Vector3 v_RTip() const;
  /// Unit shaft direction that goes with the position: from the trocar to the tip, and as it was
  /// where the tip is near the trocar or above it.
  Vector3 s_R() const;
  /// Yaw, pitch, insertion, roll.
  Vector4 joints() const;
  double roll() const { return dofs_[3].x; }
  double roll_rate() const { return dofs_[3].v; }

 private:
  /// Of four degrees of freedom in the present space.
  Vector3 tip_of(double x, double y, double z) const;
  void enter(Space space);
  bool plan(Space space, const std::array<double, 4>& target);
  void come_to_rest();
  bool overdue() const;
  Kinematic stream_target(int dof, double dt) const;
  void advance_stream(double dt);
  void advance_velocity(double dt);
  void advance_stopping(double dt);
  bool plan_leaves_workspace() const;
  void hinder(const Vector3& p_before);
  bool stop_leaves_workspace(const std::array<StreamFilter, 4>& filters) const;
  bool leads_out(const Vector3& to) const;
  bool further_out(const Vector3& p_RTip) const;
  std::array<DofLimits, 4> dof_limits(Space space) const;

  Limits limits_{};
  bool paper_ = false;
  double duration_ = 0.5;
  Mode mode_ = Mode::kRest;
  Space space_ = Space::kCartesian;
  Dofs dofs_{};
  bool axial_ = false;
  bool at_wall_ = false;
  Vector3 axis_R_ = Vector3::UnitZ();  ///< while axial
  Vector3 push_R_ = Vector3::Zero();   ///< of the force at the tip
  std::array<StreamFilter, 4> filters_{};
  std::array<AlphaBeta, 4> estimates_{};
  std::array<StreamDelay, 4> delays_{};
  std::array<double, 4> rate_{};
  std::array<double, 4> target_{};
  Space target_space_ = Space::kCartesian;
  double tick_ = 0;     ///< the control period [s]
  double clock_ = 1;    ///< the set-point's time per real time in the last advance
  double pace_ = 0;     ///< base duration of the present profile [s]
  double age_ = 0;      ///< since the last stream sample [s]
  double spacing_ = 0;  ///< of the last two samples [s]
  Profiler profiler_;
  bool then_go_ = false;  ///< go to target_ once stopped
};

}  // namespace surg
