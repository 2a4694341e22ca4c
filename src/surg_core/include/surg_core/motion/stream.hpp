// Stream filter: follows a stream of targets within velocity, acceleration and jerk limits, in
// closed form, with no planning and no failure branch; and the alpha-beta estimate that feeds it.
#pragma once

#include "surg_core/motion/quintic.hpp"

namespace surg {

/// Fixed-gain alpha-beta estimate of position and velocity from samples at a measured spacing, and
/// the acceleration as its low-passed change.
class AlphaBeta {
 public:
  /// Forgets the past: position x, velocity v.
  void reset(double x, double v = 0);
  /// A new sample 'spacing' seconds after the last one. Gains follow the spacing (30 Hz: 0.852 /
  /// 0.703; 500 Hz: 0.612 / 0.279).
  void update(double x, double spacing);
  /// Estimate 'age' seconds after the last sample.
  Kinematic predict(double age) const;

 private:
  double x_ = 0, v_ = 0, a_ = 0;
};

/// One axis of a delay: a third-order Bessel low-pass, whose group delay is the same at all
/// frequencies that it lets pass and whose overshoot is below 1 %. A stream keeps its shape and
/// only comes later, with less acceleration: for arms that cannot follow a hand's, and would
/// overshoot.
class StreamDelay {
 public:
  StreamDelay() = default;
  /// delay [s] >= 0; 0 is no delay.
  explicit StreamDelay(double delay) : delay_(delay) {}
  void reset(const Kinematic& state) { state_ = state; }
  /// Whether it does anything at this tick; a delay of less than one tick cannot.
  bool works(double T) const { return delay_ > 0 && delay_ >= T; }
  /// T seconds go by with the input at x.
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
  explicit StreamFilter(const DofLimits& limits);
  void reset(const Kinematic& state);
  /// One tick of T seconds towards a target predicted one tick ahead. Never
  /// leaves the velocity, acceleration and jerk limits. A target that is not finite: comes to rest.
  void step(const Kinematic& target, double T);
  /// One tick of the hardest braking inside the same limits; in the end it stands still. It does so
  /// where Braking::stop says, to within |v| T + |a| T^2: ticks cannot switch in between.
  void brake(double T);
  const Kinematic& state() const { return state_; }

 private:
  void integrate(double jerk, double T);

  DofLimits limits_{};
  Kinematic state_{};
};

}  // namespace surg
