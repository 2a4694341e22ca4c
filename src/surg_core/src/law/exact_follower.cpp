#include "surg_core/law/exact_follower.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/limits/flange_cap.hpp"

namespace surg {
namespace {

constexpr double kLagRate = 0.02;    // of the joint's way: how fast another lag is taken up
constexpr double kMostLate = 0.04;   // [s] that an arm may be late on its way
constexpr double kCatchUp = 2;       // [1/s] at which it makes up for it
constexpr double kForget = 20;       // [1/s] at which a lateness on its way is forgotten
constexpr double kSlowWay = 0.1;     // [rad/s] a slower reference does not tell how late the arm is
constexpr double kLate = 0.006;      // [s] so late, the flange shall be slower
constexpr double kSlowFlange = 0.6;  // of the flange's speed, meanwhile
constexpr double kSlowing = 0.3;    // [s] until the flange is that slow; hard braking bends the way
constexpr double kHastening = 1.5;  // [s] until it is fast again
constexpr double kAtOnce = 1e-6;    // [s] a servo that has no lag
constexpr double kEnoughRoom = 0.02;  // [rad/s] a correction that lacks less needs no room

}  // namespace

ExactFollower::ExactFollower(int joints, const Options& options) : options_(options) {
  const bool stated = options.servo.size() == joints;
  link_.servo = stated ? options.servo : JointVector(JointVector::Zero(joints));
  measured_ = link_;
  reset(JointVector::Zero(joints));
}

void ExactFollower::reset(const JointVector& q, const JointVector& qd) {
  q_ref_ = expected_ = q;
  v_last_ = smooth_ = late_ = rate_ = cut_ = JointVector::Zero(q.size());
  qd_last_ = qd.size() == q.size() ? qd : v_last_;
  correction_ = qd_last_;
  history_.fill(q);
  way_.fill(q);
  newest_ = 0;
  behind_ = 0;
  rejoins_ = false;
}

/// One period of the reference, and of the arm that does what the link's lag says.
void ExactFollower::move_reference(const JointVector& dq) {
  const JointVector then = delayed_reference();
  q_ref_ += dq;
  newest_ = (newest_ + 1) % kHistory;
  history_[newest_] = q_ref_;
  v_last_ = dq / options_.T;
  approach_link();
  const JointVector now = delayed_reference();
  smooth_ += servo_share() * (v_last_ - smooth_);
  late_ += servo_share() * ((now - then) / options_.T - late_);
  const JointVector before = expected_;
  expected_ = now - link_.servo.maxCoeff() * late_;
  rate_ = (expected_ - before) / options_.T;
  way_[newest_] = expected_;
}

/// A value of the past, between two samples.
JointVector ExactFollower::earlier(const History& samples, double seconds) const {
  const double periods = std::min(seconds / options_.T, kHistory - 2.0);
  const int whole = static_cast<int>(periods);
  const auto at = [&](int back) { return samples[(newest_ + kHistory - back) % kHistory]; };
  return at(whole) + (periods - whole) * (at(whole + 1) - at(whole));
}

/// One step towards the nearest point of the way.
void ExactFollower::find_lateness(const JointVector& q, double since) {
  const double T = options_.T, at = std::max(behind_ - since, 0.0);
  const JointVector here = on_its_way(at);
  const JointVector rate = (here - on_its_way(at + T)) / T;
  const double late = rate.dot(here - q) / (rate.squaredNorm() + kSlowWay * kSlowWay);
  if (std::isfinite(late)) {
    behind_ =
        std::clamp((1 - kForget * T) * behind_ + std::clamp(late, -2 * T, 2 * T), 0.0, kMostLate);
  }
  const double rate_of_share =
      (1 - kSlowFlange) * (behind_ > kLate ? -1 / kSlowing : 1 / kHastening);
  flange_share_ = std::clamp(flange_share_ + T * rate_of_share, kSlowFlange, 1.0);
}

/// Another lag moves the expected arm along its path, by a small share of the path's speed.
void ExactFollower::approach_link() {
  const double most = kLagRate * options_.T;
  const auto approach = [&](double& now, double then) {
    now += std::clamp(then - now, -most, most);
  };
  approach(link_.dead_time, measured_.dead_time);
  for (Eigen::Index i = 0; i < link_.servo.size(); ++i) {
    approach(link_.servo[i], measured_.servo[i]);
  }
}

/// Of a new velocity, that the slowest servo takes up within one period.
double ExactFollower::servo_share() const {
  return -std::expm1(-options_.T / std::max(link_.servo.maxCoeff(), kAtOnce));
}

void ExactFollower::skip(const JointVector& dq) {
  move_reference(dq);
  rejoins_ = true;
}

void ExactFollower::coast() {
  const bool rejoins = rejoins_;
  skip(options_.T * v_last_);
  rejoins_ = rejoins;  // the correction goes on as well
}

void ExactFollower::take_up(const JointVector& qd) {
  qd_last_ = qd;
  rejoins_ = true;
}

JointVector ExactFollower::advance(const JointVector& dq, const JointVector& q, const Jacobian& J,
                                   double feedback_scale, double since, const Push* push,
                                   const RcmRows* pivot) {
  const double gain = feedback_scale * options_.gain;
  const JointVector v = dq / options_.T;
  find_lateness(q, since);
  const double ahead = since - behind_;
  JointVector error = (ahead > 0 ? JointVector(expected_ + ahead * rate_) : on_its_way(-ahead)) - q;
  if (pivot) error += rcm_correction({pivot->J, pivot->e - pivot->J * error}).dq;
  // An arm that overshot away from the force stays there: the way back raises the force.
  const double into = push ? -push->tip.dot(error) : 0.0;
  if (into > 0) error += into * push->way;
  if (rejoins_) {  // from the last command, all joints by one factor
    correction_ = qd_last_ - v;
    rejoins_ = false;
  }
  // The commands stand for a period: with this share the joints lag alike by their sampled motion.
  const JointVector quicker = link_.servo.maxCoeff() - link_.servo.array();
  const JointVector held = (servo_share() / options_.T * quicker).cwiseProduct(smooth_ - v);
  const double hurry = gain > 0 ? kCatchUp * behind_ : 0;
  const JointVector change =
      held + hurry * rate_ + share_of_pull(error, gain) * gain * error - correction_;
  const double share = largest_share(v + correction_, change);
  correction_ += share * change;
  cut_ = (1 - share) * change;
  move_reference(dq);
  qd_last_ = within_limits(v + correction_, J);
  return qd_last_;
}

/// The share of gain * error with which every joint can still brake to the reference at half its
/// acceleration limit; 1 for small errors. Joints that came back each at its own speed would leave
/// the pivot.
double ExactFollower::share_of_pull(const JointVector& error, double gain) const {
  double share = 1;
  if (!(gain > 0)) return share;
  for (Eigen::Index i = 0; i < options_.acceleration.size(); ++i) {
    const double a = 0.5 * options_.acceleration[i], bend = a / (gain * gain);
    const double size = std::abs(error[i]);
    // The same slope there.
    if (size > bend) share = std::min(share, std::sqrt(a * (2 * size - bend)) / (gain * size));
  }
  return share;
}

/// The largest share of 'change' that the limits leave to all joints.
double ExactFollower::largest_share(const JointVector& from, const JointVector& change) const {
  double share = 1;
  const auto keep = [&](double at, double step, double low, double high) {
    if (step > 0) share = std::min(share, (high - at) / step);
    if (step < 0) share = std::min(share, (low - at) / step);
  };
  for (Eigen::Index i = 0; i < options_.velocity.size(); ++i) {
    keep(from[i], change[i], -options_.velocity[i], options_.velocity[i]);
  }
  for (Eigen::Index i = 0; i < options_.acceleration.size(); ++i) {
    const double most = options_.acceleration[i] * options_.T;
    keep(from[i], change[i], qd_last_[i] - most, qd_last_[i] + most);
  }
  return std::max(share, 0.0);
}

/// Applies the limits to the final command, in case the reference leaves no room.
JointVector ExactFollower::within_limits(JointVector qd, const Jacobian& J) const {
  for (Eigen::Index i = 0; i < options_.velocity.size(); ++i) {
    qd[i] = std::clamp(qd[i], -options_.velocity[i], options_.velocity[i]);
  }
  for (Eigen::Index i = 0; i < options_.acceleration.size(); ++i) {
    const double most = options_.acceleration[i] * options_.T * (1 - 1e-9);  // for rounding
    qd[i] = std::clamp(qd[i], qd_last_[i] - most, qd_last_[i] + most);
  }
  if (J.cols() == qd.size() && options_.acceleration.size() == qd.size()) {
    const JointVector slow = braked_together(qd_last_, options_.acceleration, options_.T);
    qd = slowed_flange(J, options_.flange_velocity, qd, slow);
  }
  return qd;
}

JointVector ExactFollower::wanted_room() const {
  return cut_ - cut_.cwiseMax(-kEnoughRoom).cwiseMin(kEnoughRoom);
}

}  // namespace surg
