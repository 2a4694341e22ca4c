// Profiler for discrete targets: one quintic per degree of freedom with a common duration, extended
// until velocity, acceleration and jerk limits hold. Paper, "Velocity Profiler"; its base
// duration is d = 0.5 s. All extremes are exact, none is sampled.
#pragma once

#include <array>

#include "surg_core/motion/braking.hpp"
#include "surg_core/motion/quintic.hpp"

namespace surg {

/// Four degrees of freedom: x, y, z, roll or yaw, pitch, insertion, roll.
class Profiler {
 public:
  static constexpr int kDof = 4;

  Profiler() = default;
  /// All of them are positive.
  Profiler(const std::array<DofLimits, kDof>& limits, double base_duration);

  /// Starts from any state (for example the stream's), so that a change of mode is continuous.
  void reset(const std::array<Kinematic, kDof>& state);
  /// Plans from the present state to rest at the target. A start in motion can overshoot both ends
  /// by far. The first option that keeps the limits is used:
  ///
  ///   1. a quintic of the shortest duration that a scan finds;
  ///   2. all accelerations to zero with full jerk, then such a quintic (1 fails where the present
  ///      acceleration is beyond its limit);
  ///   3. a stop in minimum time, then a quintic from rest, which always holds.
  ///
  /// Returns whether the limits hold. They do not if the present state is beyond one. A target that
  /// is not finite is ignored (returns false, the present plan continues).
  ///
  /// Re-plan from the profiler's own state, never from a measured acceleration.
  bool plan(const std::array<double, kDof>& target);
  /// The same with the paper's fixed duration and no extension (--law paper re-plans every cycle).
  void plan_fixed(const std::array<double, kDof>& target, double duration);
  /// Advances the profile clock by dt.
  void advance(double dt);
  const std::array<Kinematic, kDof>& state() const { return state_; }
  /// The positions that advance(dt) would lead to.
  std::array<double, kDof> position_after(double dt) const;
  bool done() const;                                         ///< the end of the profile is reached
  double duration() const;                                   ///< of the present profile [s]
  const Quintic& quintic(int dof) const { return q_[dof]; }  ///< the part after the braking, if any
  double brake_duration() const { return brake_duration_; }  ///< [s] before the quintics

 private:
  using Brake = Braking (*)(const Kinematic&, const DofLimits&);
  using Quintics = std::array<Quintic, kDof>;
  bool build(const std::array<Kinematic, kDof>& from, const std::array<double, kDof>& target,
             double duration, Quintics& q) const;
  bool search(const std::array<Kinematic, kDof>& from, const std::array<double, kDof>& target,
              Quintics& q) const;
  bool brake_first(Brake brake, const std::array<Kinematic, kDof>& from,
                   const std::array<double, kDof>& target);

  std::array<DofLimits, kDof> limits_{};
  double base_duration_ = 0.5;
  double t_ = 0;  // since the plan was made
  double brake_duration_ = 0;
  std::array<Braking, kDof> brake_{};
  Quintics q_{};
  std::array<Kinematic, kDof> state_{};
};

}  // namespace surg
