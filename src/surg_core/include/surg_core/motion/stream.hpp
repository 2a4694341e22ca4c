// Filters of command streams: a jerk-limited tracking filter in closed form (no planning, no
// failure branch), and an optional delay. stream_input.hpp has what feeds them.
#pragma once

#include "surg_core/motion/quintic.hpp"

namespace surg {

/// Delay of one axis: a third-order Bessel low-pass. Its group delay is the same for all
/// frequencies that pass, and its overshoot is below 1 %. A stream keeps its shape and gets less
/// acceleration, for arms that could not follow a hand's.
class StreamDelay {
 public:
  StreamDelay() = default;
  /// delay [s] >= 0; 0 is no delay.
  explicit StreamDelay(double delay) : delay_(delay) {}
  void reset(const Kinematic& state) { state_ = state; }
  /// From now on another delay [s]. Position, velocity and acceleration go on from where they are.
  void set(double delay) { delay_ = delay; }
  /// Whether the delay has an effect at this tick; a delay below one tick has none.
  bool works(double T) const { return delay_ > 0 && delay_ >= T; }
  /// Advances T seconds with the input at x.
  void step(double x, double T);
  /// The delayed stream 'ahead' seconds later.
  Kinematic predict(double ahead) const;

 private:
  double delay_ = 0;
  Kinematic state_{};
};

/// One axis of the jerk-limited tracking filter.
class StreamFilter {
 public:
  StreamFilter() = default;
  /// All limits are positive.
  explicit StreamFilter(const DofLimits& limits) : limits_(limits) {}
  void reset(const Kinematic& state) { state_ = state; }
  /// One tick of T seconds towards a target predicted one tick ahead. Never exceeds the velocity,
  /// acceleration and jerk limits. Comes to rest if the target is not finite. period [s]: at which
  /// ticks come, if they are longer than T; then the gains are lower. ahead: of a delayed target,
  /// where it will be soon; the filter brakes as early as either needs it.
  void step(const Kinematic& target, double T, double period = 0, const Kinematic* ahead = nullptr);
  /// One tick of the hardest braking inside the limits, down to standstill. It stops where
  /// Braking::stop predicts, to within |v| T + |a| T^2, because jerk changes only between ticks.
  void brake(double T);
  const Kinematic& state() const { return state_; }

 private:
  void integrate(double jerk, double T);

  DofLimits limits_{};
  Kinematic state_{};
};

}  // namespace surg
