// The exact form in front of a robot that lags: a virtual arm goes exactly where the law says, and
// the real one is made to follow it joint by joint.
#pragma once

#include "surg_core/types.hpp"

namespace surg {

/// Velocity commands that make a lagging arm follow a virtual reference:
///
///   qd = v + lag a + gain (q_ref - q),   v = dq / T,   a = (v - v_last) / T
///
/// The reference lies on the constraint by construction and knows neither noise nor lag. A link
/// that answers late, by delay or first-order, lets each joint fall behind by the lag's error times
/// its acceleration: the second term takes that away to first order, the third what is left. The
/// feedback acts on joints, so that pivot, tip and roll come back together.
///
/// No two joints lag alike, and only the differences move the pivot. So each joint's lag is learnt
/// from what is left: a wrong lag leaves the error e = (lag error) phi with phi' = a - gain phi,
/// and a normalised gradient step on it, bounded at any amplitude, moves the lag. It stays between
/// 0 and three times the stated one, and stands still where nothing accelerates.
///
/// The feedback is gain e, and for a large e the speed from which the joint can still brake to the
/// reference at half its acceleration limit. The command keeps the joints' limits whatever happens:
/// what is added to v changes by one factor for all joints as far as it may (joint by joint would
/// move the pivot ten times as much).
class ExactFollower {
 public:
  /// What a reference should use of the joints' limits, so that the correction has room.
  static constexpr double kReferenceVelocity = 0.95;
  static constexpr double kReferenceAcceleration = 0.9;

  struct Options {
    double lag = 0;       ///< [s] of the link, as stated; 0: none, and nothing is learnt
    double gain = 50;     ///< [1/s] feedback; stable up to about 1 / lag
    double learning = 2;  ///< [1/s] of the lags; 0: they stay as stated
    double T = 0.002;     ///< [s] control period
    /// Limits of the command per joint [rad/s, rad/s^2]; empty: none. The reference must keep to
    /// less, so that there is room.
    JointVector velocity = {}, acceleration = {};
  };
  ExactFollower(int joints, const Options& options);

  /// The reference is where the arm is, at rest. What was learnt stays.
  void reset(const JointVector& q);
  /// The virtual arm: what the law steps from.
  const JointVector& reference() const { return q_ref_; }
  /// Moves the reference on by dq (the law's step, limits applied) and returns the command for the
  /// link [rad/s], 'q' being measured before the step.
  JointVector advance(const JointVector& dq, const JointVector& q);
  /// Velocity of the reference in the last period [rad/s].
  const JointVector& velocity() const { return v_last_; }
  /// Everything that a step reads, for an image of the controller (image.hpp).
  template <typename Image>
  void remembered(Image& image) {
    image(q_ref_, v_last_, qd_last_, correction_, lag_, phi_);
  }
  /// How far the arm is from the reference [rad], the largest joint.
  double behind(const JointVector& q) const;
  /// Each joint's lag as learnt so far [s].
  const JointVector& lag() const { return lag_; }

 private:
  double feedback(Eigen::Index i, double error) const;
  double room(const JointVector& from, const JointVector& change) const;
  JointVector within_limits(JointVector qd) const;
  void learn(const JointVector& error);

  Options options_;
  JointVector q_ref_, v_last_, qd_last_, correction_, lag_, phi_;
};

}  // namespace surg
