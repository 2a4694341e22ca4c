// Makes an arm with lag follow the virtual reference of the exact form, joint by joint.
#pragma once

#include <array>
#include <limits>

#include "surg_core/types.hpp"

namespace surg {

/// Computes velocity commands with which an arm follows the reference, delayed by the link's lag:
///
///   qd = v + (lag_i - delay) a + feedback(q_delayed - q),   v = dq / T,   a = (v - v_last) / T
///
/// q_delayed is the reference 'delay' ago, where 'delay' is the stated lag in whole periods. The
/// reference satisfies the constraint and has neither noise nor lag. An arm whose joints all have
/// the same lag therefore stays on the pivot, only later. Compensating the common lag would amplify
/// every jerk of the input (pivot error on a surgeon's motion: 0.16 instead of 0.02 mm). Only
/// differences between the joints' lags move the pivot.
///
/// Lags stated joint by joint (Options::joint_lag): 'delay' is the slowest joint's lag, rounded up,
/// and 'a' passes a first-order filter with this time constant. The command of joint i is then the
/// reference's velocity through (1 + lag_i s) / (1 + delay s). Its first-order servo 1 / (1 + lag_i
/// s) makes 1 / (1 + delay s) of it, the same for every joint, and the command never asks for more
/// velocity or acceleration than the reference (docs/design/control_law.md).
///
/// Each joint's lag is also estimated: a wrong lag leaves the error e = (lag error) phi with phi' =
/// a_delayed - gain phi, and a normalised gradient step on e adapts the lag. It stays between 0 and
/// three times the stated lag and does not change at zero acceleration. An error that no lag
/// explains is not a lag's: from it, and for two seconds after it, nothing is learnt. A link that
/// obeys late for some tens of milliseconds would otherwise leave every joint a wrong lag of its
/// own. Meanwhile the feedback is cautious and the reference slow (flange_share). The feedback acts
/// on joints, so pivot, tip and roll converge together.
///
/// The feedback is gain e. For a large e it is less, by one factor for all joints: as much as lets
/// every joint brake to the reference at half its acceleration limit. If measured states are late,
/// the caller reduces the gain by feedback_scale; from very late states the lags are not adapted.
/// The command keeps the joint limits in every case. The correction added to v is scaled by one
/// factor for all joints as far as possible: scaling joint by joint would move the pivot ten times
/// as much. What the limits withheld of it, the next step of the reference leaves room for
/// (wanted_room).
class ExactFollower {
 public:
  // What the reference may use; the rest is for the correction.
  static constexpr double kReferenceVelocity = 0.97;      ///< of each joint's velocity limit
  static constexpr double kReferenceAcceleration = 0.97;  ///< of each joint's acceleration limit

  struct Options {
    double lag = 0;         ///< [s] of the slowest joint, as stated; 0: none; nothing is learnt
    double gain = 50;       ///< [1/s] feedback; stable up to about 1 / lag
    double learning = 0.3;  ///< [1/s] of the lags; 0: they stay as stated
    double T = 0.002;       ///< [s] control period
    /// Limits of the command per joint [rad/s, rad/s^2]; empty: none. The reference must stay below
    /// them.
    JointVector velocity = {}, acceleration = {};
    /// [m/s] limit of the flange origin's speed; applies where 'advance' gets the arm's Jacobian.
    double flange_velocity = std::numeric_limits<double>::infinity();
    /// [s] of each joint, as stated; empty: 'lag' for all of them.
    JointVector joint_lag = {};
  };
  /// A force on the tip, against which the feedback must not move it (F25).
  struct Push {
    JointVector tip;  ///< speed of the tip along the force, per joint velocity [m/rad]
    JointVector way;  ///< joints that move the tip along the force on the pivot [rad/m]
  };
  ExactFollower(int joints, const Options& options);

  /// Sets the reference to the arm's position, at rest. The adapted lags stay. qd: the last
  /// command, which fades out; empty: zero.
  void reset(const JointVector& q, const JointVector& qd = {});
  /// Joints of the virtual arm, from which the law steps.
  const JointVector& reference() const { return q_ref_; }
  /// Advances the reference by dq (a step of the law within limits) and returns the command for the
  /// link [rad/s]. q: measured before the step; J: the arm's Jacobian there; feedback_scale: factor
  /// of the gain, in (0, 1]; since [s]: time since the reference was where it is now, less than T;
  /// push: nullptr without a force.
  JointVector advance(const JointVector& dq, const JointVector& q, const Jacobian& J = {},
                      double feedback_scale = 1, double since = 0, const Push* push = nullptr);
  /// Advances the reference by dq over a period that passed without a command.
  void skip(const JointVector& dq);
  /// The same at constant velocity, as the arm moves meanwhile.
  void coast();
  /// Continues from another last command [rad/s] than the follower gave.
  void take_up(const JointVector& qd);
  /// [rad/s] What the limits did not leave of the last correction's change, beyond a negligible
  /// rest. A reference that takes all of a joint's acceleration for itself would keep a correction
  /// that has become wrong for as long as it brakes, and the arm off its pivot.
  JointVector wanted_room() const;
  /// Share of the flange's speed limit that the reference may use: less while the link is in doubt,
  /// because an arm that repeats a command leaves a path that bends by the square of the speed.
  double flange_share() const { return flange_share_; }
  /// Velocity of the reference in the last period [rad/s].
  const JointVector& velocity() const { return v_last_; }
  /// Serializes everything that a step reads (snapshot.hpp).
  template <typename Archive>
  void serialize(Archive& archive) {
    archive(q_ref_, v_last_, qd_last_, correction_, lag_, phi_, newest_, rejoins_, settling_, cut_,
            flange_share_);
    for (ReferenceSample& sample : history_) archive(sample.q, sample.a);
  }
  /// Delay of the arm behind the reference [s].
  double delay() const { return n_late_ * options_.T; }
  /// Distance of the arm from the delayed reference [rad], largest joint.
  double tracking_error(const JointVector& q) const;
  /// Estimated lag of each joint [s].
  const JointVector& lag() const { return lag_; }

 private:
  double share_of_pull(const JointVector& error, double gain) const;
  bool explained_by_lags(const JointVector& error) const;
  double largest_share(const JointVector& from, const JointVector& change) const;
  JointVector push_reference(const JointVector& dq);
  JointVector within_limits(JointVector qd, const Jacobian& J) const;
  void adapt_lags(const JointVector& error);
  bool in_doubt() const;
  void pace_flange();

  static constexpr int kHistory = 32;  // periods
  struct ReferenceSample {
    JointVector q, a;
  };
  const ReferenceSample& delayed_reference() const {
    return history_[(newest_ + kHistory - n_late_) % kHistory];
  }

  Options options_;
  int n_late_ = 0;
  double smoothing_ = 1;                           // share of a new acceleration; 1: not filtered
  std::array<ReferenceSample, kHistory> history_;  // of the reference
  int newest_ = 0;
  bool rejoins_ = false;  // the last command is not the reference's velocity plus the correction
  int settling_ = 0;      // [periods] until what is left of a gap or a late link teaches no lags
  double flange_share_ = 1;
  JointVector q_ref_, v_last_, qd_last_, correction_, lag_, phi_;
  JointVector cut_;  // [rad/s] of the correction's change
};

}  // namespace surg
