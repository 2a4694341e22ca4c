// Measures the lag of a robot link from ordinary motion.
#pragma once

#include "surg_core/types.hpp"

namespace surg {

/// Estimates the time from a velocity command to the motion it causes: dead time plus the time
/// constant of the velocity servo.
///
/// The integrated commands c lead the measured positions q by the lag times the velocity. Both pass
/// the same high-pass filter, which removes their constant difference:
///
///   c - q = lag * v,   lag = sum (c - q) v / sum v^2   over all joints and the recent past.
///
/// Of all joints together, and of each of them. The estimate needs motion; until enough of it has
/// been seen, it is NaN.
class LagMeter {
 public:
  explicit LagMeter(int joints = 0) { restart(joints); }

  /// Call it once per cycle. qd_command: sent in the previous cycle [rad/s]; q: measured now [rad];
  /// age: of q [s]; dt: since the previous cycle [s].
  void step(const JointVector& qd_command, const JointVector& q, double age, double dt);
  /// Call it in cycles in which the arm does not obey commands. The estimate is kept.
  void interrupt() { running_ = false; }
  /// [s] of all joints together, or NaN.
  double lag() const { return lag_of(cross_.sum(), square_.sum()); }
  /// [s] of each joint, or NaN.
  JointVector joint_lag() const;

 private:
  void restart(int joints);
  static double lag_of(double cross, double square);

  bool running_ = false;
  JointVector q_last_, lead_, moved_;  // lead_: filtered c - q; moved_: filtered q
  JointVector cross_, square_;         // the two sums of each joint, in [rad^2] and [rad^2 / s]
};

}  // namespace surg
