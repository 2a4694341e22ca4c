// The exact form in front of a robot that lags: a virtual arm goes exactly where the law says, and
// the real one is made to follow it joint by joint.
#pragma once

#include <array>
#include <limits>

#include "surg_core/types.hpp"

namespace surg {

/// Velocity commands that make a lagging arm follow a virtual reference, later by the link's lag:
///
///   qd = v + (lag_i - delay) a + feedback(q_late - q),   v = dq / T,   a = (v - v_last) / T
///
/// q_late is the reference 'delay' ago, the stated lag in whole periods. The reference lies on the
/// constraint by construction and knows neither noise nor lag, and an arm whose joints all lag
/// alike stays on it by itself, only later; making up for the common lag would amplify every jerk,
/// and the pivot with it (a surgeon's motion: 0.16 instead of 0.02 mm). But no two joints lag
/// alike, and only the differences move the pivot. So each joint's lag is learnt from what is left:
/// a wrong lag leaves the error e = (lag error) phi with phi' = a_late - gain phi, and a normalised
/// gradient step on it, bounded at any amplitude, moves the lag. It stays between 0 and three times
/// the stated one, and stands still where nothing accelerates. The feedback acts on joints, so that
/// pivot, tip and roll come back together.
///
/// The feedback is gain e, and for a large e the speed from which the joint can still brake to the
/// reference at half its acceleration limit. Where measured states come late the caller takes the
/// gain back ('trust'); from much later ones nothing is learnt. The command keeps the joints'
/// limits whatever happens: what is added to v changes by one factor for all joints as far as it
/// may (joint by joint would move the pivot ten times as much).
class ExactFollower {
 public:
  /// What a reference should use of the joints' limits, so that the correction has room.
  static constexpr double kReferenceVelocity = 0.97;
  static constexpr double kReferenceAcceleration = 0.97;

  struct Options {
    double lag = 0;         ///< [s] of the link, as stated; 0: none, and nothing is learnt
    double gain = 50;       ///< [1/s] feedback; stable up to about 1 / lag
    double learning = 0.3;  ///< [1/s] of the lags; 0: they stay as stated
    double T = 0.002;       ///< [s] control period
    /// Limits of the command per joint [rad/s, rad/s^2]; empty: none. The reference must keep to
    /// less, so that there is room.
    JointVector velocity = {}, acceleration = {};
    /// [m/s] of the flange's origin; counts where 'advance' is given the arm's Jacobian.
    double flange_velocity = std::numeric_limits<double>::infinity();
  };
  ExactFollower(int joints, const Options& options);

  /// The reference is where the arm is, at rest. What was learnt stays. qd: the last command, which
  /// fades from there; empty: zero.
  void reset(const JointVector& q, const JointVector& qd = {});
  /// The virtual arm: what the law steps from.
  const JointVector& reference() const { return q_ref_; }
  /// Moves the reference on by dq (the law's step, limits applied) and returns the command for the
  /// link [rad/s], 'q' being measured before the step; J: the arm's Jacobian there; trust: share of
  /// the feedback's gain, in (0, 1].
  JointVector advance(const JointVector& dq, const JointVector& q, const Jacobian& J = {},
                      double trust = 1);
  /// Velocity of the reference in the last period [rad/s].
  const JointVector& velocity() const { return v_last_; }
  /// Everything that a step reads, for an image of the controller (image.hpp).
  template <typename Image>
  void remembered(Image& image) {
    image(q_ref_, v_last_, qd_last_, correction_, lag_, phi_, newest_);
    for (Moment& moment : past_) image(moment.q, moment.a);
  }
  /// How much later than the reference the arm is to be [s].
  double delay() const { return n_late_ * options_.T; }
  /// How far the arm is from the reference of then [rad], the largest joint.
  double behind(const JointVector& q) const;
  /// Each joint's lag as learnt so far [s].
  const JointVector& lag() const { return lag_; }

 private:
  double feedback(Eigen::Index i, double error, double gain) const;
  double room(const JointVector& from, const JointVector& change) const;
  JointVector within_limits(JointVector qd, const Jacobian& J) const;
  void learn(const JointVector& error);

  static constexpr int kPast = 32;  // periods
  struct Moment {
    JointVector q, a;
  };
  const Moment& late() const { return past_[(newest_ + kPast - n_late_) % kPast]; }

  Options options_;
  int n_late_ = 0;
  std::array<Moment, kPast> past_;  // of the reference
  int newest_ = 0;
  JointVector q_ref_, v_last_, qd_last_, correction_, lag_, phi_;
};

}  // namespace surg
