// The moving set-point: what the instrument shall do next, from whichever kind of command came
// last. Four degrees of freedom in the rcm frame: x, y, z, roll (Cartesian) or yaw, pitch,
// insertion, roll (spherical). A plain value: copy it, advance the copy, keep the one whose step
// the limits allow.
#pragma once

#include <array>

#include "surg_core/config.hpp"
#include "surg_core/profiler.hpp"
#include "surg_core/stream.hpp"
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
  Setpoint(const Limits& limits, double profiler_duration, bool paper);

  /// Stands still at a tip position [m] in the rcm frame and a roll [rad].
  void reset(const Vector3& p_RTip, double roll);
  /// A sample of a pose stream (servo_cp, servo_jp).
  void follow(Space space, const std::array<double, 4>& target, double T);
  /// A velocity to hold (servo_cv, servo_jv).
  void drive(Space space, const std::array<double, 4>& rate);
  /// A discrete Cartesian target (interpolate_cp, move_cp): quintic to rest there. Where its
  /// overshoot from the present motion would leave the workspace, the tip stops first.
  void go_to(const std::array<double, 4>& target);
  /// Decelerates the tip along its present direction.
  void stop();

  /// Stands still where it is and starts anew from rest: a limit has brought the arm to a stop, and
  /// a velocity kept from before would hold it there for ever. The target stays.
  void stand();

  /// Real time passes: stream samples get older.
  void elapse(double T) { age_ += T; }
  /// The set-point moves on by dt <= T of its own clock.
  void advance(double dt);

  Mode mode() const { return mode_; }
  Space space() const { return space_; }
  Vector3 p_RTip() const;
  Vector3 v_RTip() const;
  double roll() const { return dofs_[3].x; }
  double roll_rate() const { return dofs_[3].v; }

 private:
  void enter(Space space);
  void advance_stream(double dt);
  void advance_velocity(double dt);
  void advance_stopping(double dt);
  bool plan_leaves_workspace() const;
  bool further_out(const Vector3& p_RTip) const;
  std::array<DofLimits, 4> dof_limits(Space space) const;

  Limits limits_{};
  bool paper_ = false;
  double duration_ = 0.5;
  Mode mode_ = Mode::kRest;
  Space space_ = Space::kCartesian;
  Dofs dofs_{};
  std::array<StreamFilter, 4> filters_{};
  std::array<AlphaBeta, 4> estimates_{};
  std::array<double, 4> rate_{};
  std::array<double, 4> target_{};
  double age_ = 0;      ///< since the last stream sample [s]
  double spacing_ = 0;  ///< of the last two samples [s]
  Profiler profiler_;
  bool then_go_ = false;  ///< go to target_ once stopped
};

}  // namespace surg
