// Profiler for discrete targets: one quintic per degree of freedom with a common duration, extended
// until velocity, acceleration, jerk and position limits hold. Paper, "Velocity Profiler"; d = 0.5
// s is its base duration. Every extreme is exact; none is sampled.
#pragma once

#include <array>

#include "surg_core/motion/braking.hpp"
#include "surg_core/motion/quintic.hpp"

namespace surg {

/// Four degrees of freedom: x, y, z, roll or yaw, pitch, insertion, roll.
class Profiler {
 public:
  static constexpr int kDof = 4;
  using Bounds = std::array<Interval, kDof>;

  Profiler() = default;
  Profiler(const std::array<DofLimits, kDof>& limits, double base_duration);

  /// Forgets everything and stands at x.
  void reset(const std::array<double, kDof>& x);
  /// Starts from an arbitrary state (for example the stream's), so that a change of mode does not
  /// jump.
  void reset(const std::array<Kinematic, kDof>& state);
  /// Plans from the present state to rest at the target.
  ///
  /// Each degree of freedom stays inside its bounds, or, where its start or its target lies outside
  /// of them, inside the hull of all three. Without bounds a start in motion can swing far beyond
  /// both ends, the farther the longer the slowest degree of freedom needs. Taken is the first that
  /// keeps limits and bounds:
  ///   1. a quintic, of the least duration that a scan finds;
  ///   2. every acceleration to zero with full jerk, then such a quintic (1 cannot hold where the
  ///      present acceleration is beyond its limit);
  ///   3. a stop in the least time, then a quintic from rest, which is monotone and always holds.
  /// Returns whether limits and bounds hold. They do not where the present state is beyond a limit
  /// or leaves no room for the stop of 3, which is taken then. A target that is not finite is
  /// ignored (false, the present plan goes on).
  ///
  /// Re-plan from the profiler's own state, never from a measured acceleration.
  bool plan(const std::array<double, kDof>& target, const Bounds& bounds = Bounds{});
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
  /// Least and greatest position of a degree of freedom between two times since the plan was made,
  /// exact, braking included.
  Interval excursion(int dof, double t0, double t1) const;

 private:
  using Brake = Braking (*)(const Kinematic&, const DofLimits&);
  using Quintics = std::array<Quintic, kDof>;
  struct Goal {
    std::array<double, kDof> target;
    Bounds hull;
  };
  enum class Check { kHolds, kBeyondLimits, kOutOfBounds };
  Check build(const std::array<Kinematic, kDof>& from, const Goal& goal, double duration,
              Quintics& q) const;
  bool search(const std::array<Kinematic, kDof>& from, const Goal& goal, Quintics& q) const;
  bool brake_first(Brake brake, const std::array<Kinematic, kDof>& from, const Goal& goal);

  std::array<DofLimits, kDof> limits_{};
  double base_duration_ = 0.5;
  double t_ = 0;  // since the plan was made
  double brake_duration_ = 0;
  std::array<Braking, kDof> brake_{};
  Quintics q_{};
  std::array<Kinematic, kDof> state_{};
};

}  // namespace surg
