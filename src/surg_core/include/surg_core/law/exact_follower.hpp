// Makes an arm with lag follow the virtual reference of the exact form, joint by joint.
#pragma once

#include <array>
#include <limits>

#include "surg_core/law/exact.hpp"
#include "surg_core/state/lag_meter.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Computes velocity commands with which an arm follows the reference, later by the link's lag:
///
///   qd = v - (D - servo_i) a + feedback (expected - q),   a = s v / (1 + D s)
///
/// D is the slowest joint's servo, and the filter is the one of sampled commands. The command of
/// joint i is the reference's velocity through (1 + servo_i s) / (1 + D s). Behind dead time and
/// servo, the same is left for every joint: exp(-dead_time s) / (1 + D s). Through this the
/// reference passes to become 'expected': where an arm is that does what the link's lag says. The
/// reference satisfies the constraint and has neither noise nor lag, so an arm of this kind stays
/// on the pivot, only later. Compensating the common lag would amplify every jerk of the input. The
/// command never asks for more velocity or acceleration than the reference
/// (docs/design/control_law.md).
///
/// The lag is measured (LagMeter), and a new value is taken up gradually. The feedback acts on
/// joints, so pivot, tip and roll converge together. Across the shaft it acts on the measured
/// deviation from the pivot instead: the joints of 'expected' cut the curves of their paths, by
/// D^2 v^2 / 2 times the curvature, and leave the pivot by as much.
///
/// The feedback is gain e. For a large e it is less, by one factor for all joints: as much as lets
/// every joint brake to the reference at half its acceleration limit. The caller reduces the gain
/// by feedback_scale for a long lag and for measured states that are late. The command keeps the
/// joint limits in every case. The correction added to v is scaled by one factor for all joints as
/// far as possible: scaling joint by joint would move the pivot ten times as much. What the limits
/// withheld of it, the next step of the reference leaves room for (wanted_room).
class ExactFollower {
 public:
  /// Of each joint's limits of velocity and acceleration, that the reference may use; the rest is
  /// for the correction.
  static constexpr double kReferenceShare = 0.97;  ///< of a limit

  struct Options {
    JointVector servo;  ///< [s] stated lag of each joint, taken for a servo's; empty: none
    double gain = 50;   ///< [1/s] feedback; stable up to about 1 / lag
    double T = 0.002;   ///< [s] control period
    /// Limits of the command per joint [rad/s, rad/s^2]; empty: none. The reference must stay below
    /// them.
    JointVector velocity = {}, acceleration = {};
    /// [m/s] limit of the flange origin's speed; applies where 'advance' gets the arm's Jacobian.
    double flange_velocity = std::numeric_limits<double>::infinity();
  };
  /// A force on the tip, against which the feedback must not move it (F25).
  struct Push {
    JointVector tip;  ///< speed of the tip along the force, per joint velocity [m/rad]
    JointVector way;  ///< joints that move the tip along the force on the pivot [rad/m]
  };
  ExactFollower(int joints, const Options& options);

  /// Sets the reference to the arm's position, at rest. The link's lag stays. qd: the last command,
  /// which fades out; empty: zero.
  void reset(const JointVector& q, const JointVector& qd = {});
  /// The link's lag, as measured; it is approached by kLagRate.
  void set_link(const LinkLag& measured) { measured_ = measured; }
  /// Joints of the virtual arm, from which the law steps.
  const JointVector& reference() const { return q_ref_; }
  /// Advances the reference by dq (a step of the law within limits) and returns the command for the
  /// link [rad/s]. q: measured before the step; J: the arm's Jacobian there; feedback_scale: factor
  /// of the gain, in (0, 1]; since [s]: time since the reference was where it is now, less than T;
  /// push: nullptr without a force; pivot: measured before the step.
  JointVector advance(const JointVector& dq, const JointVector& q, const Jacobian& J = {},
                      double feedback_scale = 1, double since = 0, const Push* push = nullptr,
                      const RcmRows* pivot = nullptr);
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
  /// Share of the flange's speed limit that the reference may use: less while the arm is late on
  /// its way, because an arm that repeats a command leaves a path that bends by the square of the
  /// speed.
  double flange_share() const { return flange_share_; }
  /// Velocity of the reference in the last period [rad/s].
  const JointVector& velocity() const { return v_last_; }
  /// Serializes everything that a step reads (snapshot.hpp).
  template <typename Archive>
  void serialize(Archive& archive) {
    archive(q_ref_, v_last_, qd_last_, correction_, smooth_, late_, expected_, rate_, cut_,
            rejoins_, newest_, link_.dead_time, link_.servo, measured_.dead_time, measured_.servo);
    archive(behind_, flange_share_);
    for (JointVector& q : history_) archive(q);
    for (JointVector& q : way_) archive(q);
  }
  /// Delay of the arm behind the reference [s].
  double delay() const { return link_.slowest(); }
  /// [rad] Joints of an arm that does what the link's lag says, in the next cycle.
  const JointVector& expected() const { return expected_; }
  /// The link's lag that is in use.
  const LinkLag& link() const { return link_; }

 private:
  double share_of_pull(const JointVector& error, double gain) const;
  double largest_share(const JointVector& from, const JointVector& change) const;
  JointVector within_limits(JointVector qd, const Jacobian& J) const;
  void move_reference(const JointVector& dq);
  void approach_link();
  double servo_share() const;

  static constexpr int kHistory = 32;  // periods
  using History = std::array<JointVector, kHistory>;
  JointVector earlier(const History& samples, double seconds) const;
  // The reference a dead time before the next cycle.
  JointVector delayed_reference() const { return earlier(history_, link_.dead_time); }
  // Where an arm is expected that is so late on its way.
  JointVector on_its_way(double behind) const { return earlier(way_, behind); }
  void find_lateness(const JointVector& q, double since);

  Options options_;
  LinkLag link_, measured_;
  History history_;    // of the reference; the newest is q_ref_
  History way_;        // the same of what is expected
  double behind_ = 0;  // [s] that the arm is late on its way
  double flange_share_ = 1;
  int newest_ = 0;
  bool rejoins_ = false;  // the last command is not the reference's velocity plus the correction
  JointVector q_ref_, v_last_, qd_last_, correction_;
  JointVector smooth_, late_;    // [rad/s] the reference's velocity behind the slowest servo, and
                                 // behind the dead time as well
  JointVector expected_, rate_;  // [rad] in the next cycle, and [rad/s] towards it
  JointVector cut_;              // [rad/s] of the correction's change
};

}  // namespace surg
