// Profiler for discrete targets: one quintic per degree of freedom with a common duration, extended
// until velocity, acceleration and jerk limits hold. Paper, "Velocity Profiler"; d = 0.5 s is its
// base duration. The path between may leave the interval from start to target
// (Quintic::min_position, max_position).
#pragma once

#include <array>

#include "surg_core/quintic.hpp"

namespace surg {

struct DofLimits {
  double velocity, acceleration, jerk;
};

/// Four degrees of freedom: x, y, z, roll or yaw, pitch, insertion, roll.
class Profiler {
 public:
  static constexpr int kDof = 4;
  Profiler() = default;
  Profiler(const std::array<DofLimits, kDof>& limits, double base_duration);

  /// Forgets everything and stands at x.
  void reset(const std::array<double, kDof>& x);
  /// Starts from an arbitrary state (for example the stream's), so that a change of mode does not
  /// jump.
  void reset(const std::array<Kinematic, kDof>& state);
  /// Plans from the present state to rest at the target; extends the duration until the limits
  /// hold. Where no quintic can (the present acceleration is too large for it), brakes it to zero
  /// first. A state beyond its velocity limit cannot be helped: the least violation is taken. A
  /// target that is not finite is ignored. Re-plan from the profiler's own state, never from a
  /// measured acceleration.
  void plan(const std::array<double, kDof>& target);
  /// The same with the paper's fixed duration and no extension (--law paper re-plans every cycle).
  void plan_fixed(const std::array<double, kDof>& target, double duration);
  /// Advances the profile clock by dt.
  void advance(double dt);
  const std::array<Kinematic, kDof>& state() const { return state_; }
  bool done() const;                                         ///< the end of the profile is reached
  double duration() const;                                   ///< of the present profile [s]
  const Quintic& quintic(int dof) const { return q_[dof]; }  ///< the part after the braking, if any

 private:
  struct Plan {
    std::array<Quintic, kDof> q;
    double excess = 0;  // largest ratio of an extreme to its limit
  };
  Plan build(const std::array<Kinematic, kDof>& from, const std::array<double, kDof>& target,
             double duration, double enough) const;
  Plan search(const std::array<Kinematic, kDof>& from,
              const std::array<double, kDof>& target) const;
  Plan least_excess(const std::array<Kinematic, kDof>& from,
                    const std::array<double, kDof>& target) const;
  Kinematic braking(int dof, double t) const;

  std::array<DofLimits, kDof> limits_{};
  double base_duration_ = 0.5;
  double t_ = 0;  // since the plan was made
  double brake_duration_ = 0;
  std::array<Kinematic, kDof> brake_from_{};
  std::array<Quintic, kDof> q_{};
  std::array<Kinematic, kDof> state_{};
};

}  // namespace surg
