#include "surg_core/law/exact_follower.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/limits/flange_cap.hpp"

namespace surg {
namespace {

constexpr double kMaxLagRatio = 3;    // estimated over stated lag
constexpr double kPhiFloor = 0.003;   // [rad/s] regularises the gradient step
constexpr int kSettling = 50;         // [periods] after a gap before lags are adapted again
constexpr int kDistrust = 1000;       // [periods] after an error that no lag explains
constexpr double kAnyError = 1e-3;    // [rad] a smaller one may be a lag's
constexpr double kCautious = 0.65;    // of the gain, while the link's lag is in doubt
constexpr double kSlowFlange = 0.6;   // of the flange's speed, meanwhile
constexpr double kSlowing = 0.3;      // [s] until the flange is that slow
constexpr double kHastening = 1.5;    // [s] until it is fast again
constexpr double kEnoughRoom = 0.02;  // [rad/s] a correction that lacks less needs no room
constexpr double kAdaptAbove =
    0.7;  // feedback_scale below which the error may be due to late states

}  // namespace

ExactFollower::ExactFollower(int joints, const Options& options)
    : options_(options),
      lag_(options.joint_lag.size() == joints
               ? options.joint_lag
               : JointVector(JointVector::Constant(joints, options.lag))) {
  const double periods = options_.lag / options_.T;
  const bool listed = options_.joint_lag.size() == joints;
  // Rounded up, so that no joint of a list is ever ahead of the reference.
  n_late_ = static_cast<int>(
      std::clamp(listed ? std::ceil(periods) : std::round(periods), 0.0, kHistory - 1.0));
  smoothing_ = listed ? 1 / (n_late_ + 1.0) : 1;
  reset(JointVector::Zero(joints));
}

void ExactFollower::reset(const JointVector& q, const JointVector& qd) {
  q_ref_ = q;
  v_last_.setZero(q.size());
  qd_last_ = qd.size() == q.size() ? qd : JointVector(JointVector::Zero(q.size()));
  correction_ = qd_last_;
  cut_.setZero(q.size());
  phi_.setZero(q.size());
  history_.fill({q, JointVector::Zero(q.size())});
  newest_ = 0;
  rejoins_ = false;
}

/// The reference's velocity over a step, after which it is in the history.
JointVector ExactFollower::push_reference(const JointVector& dq) {
  const JointVector v = dq / options_.T;
  JointVector a = (v - v_last_) / options_.T;
  if (smoothing_ < 1) a = history_[newest_].a + smoothing_ * (a - history_[newest_].a);
  newest_ = (newest_ + 1) % kHistory;
  history_[newest_] = {q_ref_, a};
  return v;
}

void ExactFollower::skip(const JointVector& dq) {
  v_last_ = push_reference(dq);
  q_ref_ += dq;
  phi_ += options_.T * (delayed_reference().a - options_.gain * phi_);
  rejoins_ = true;
}

void ExactFollower::coast() {
  const bool rejoins = rejoins_;
  skip(options_.T * v_last_);
  rejoins_ = rejoins;  // the correction goes on as well
  settling_ = kSettling;
}

void ExactFollower::take_up(const JointVector& qd) {
  qd_last_ = qd;
  rejoins_ = true;
}

JointVector ExactFollower::advance(const JointVector& dq, const JointVector& q, const Jacobian& J,
                                   double feedback_scale, double since, const Push* push) {
  // Gain times lag must stay well below pi / 2, and the lag may be twice the stated one.
  const double trust = in_doubt() ? kCautious : 1;
  const double gain = trust * feedback_scale * options_.gain;
  const JointVector v = push_reference(dq);
  const JointVector& a = history_[newest_].a;
  JointVector late = delayed_reference().q;
  if (since > 0) {
    const JointVector next = n_late_ == 0
                                 ? JointVector(q_ref_ + dq)
                                 : history_[(newest_ + kHistory - n_late_ + 1) % kHistory].q;
    late += since / options_.T * (next - late);
  }
  JointVector error = late - q;
  // An arm that overshot away from the force stays there: the way back raises the force.
  const double into = push ? -push->tip.dot(error) : 0.0;
  if (into > 0) error += into * push->way;
  if (rejoins_) {  // from the last command, all joints by one factor
    correction_ = qd_last_ - v;
    rejoins_ = false;
    settling_ = kSettling;
  }
  settling_ = std::max(settling_ - 1, 0);
  JointVector change(q.size());
  const double pulled = share_of_pull(error, gain);
  const bool linear = !(into > 0) && pulled == 1;
  for (Eigen::Index i = 0; i < q.size(); ++i) {
    change[i] = (lag_[i] - delay()) * a[i] + pulled * (gain * error[i]) - correction_[i];
  }
  const double share = largest_share(v + correction_, change);
  correction_ += share * change;
  cut_ = (1 - share) * change;
  phi_ += options_.T * (delayed_reference().a - gain * phi_);
  if (!explained_by_lags(error)) settling_ = kDistrust;
  pace_flange();
  // Limits or late states also cause errors; those do not depend on the lags.
  if (linear && share == 1 && settling_ == 0 && feedback_scale > kAdaptAbove) adapt_lags(error);
  q_ref_ += dq;
  v_last_ = v;
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

/// A lag wrong by as much as the stated one leaves an error of lag * phi.
bool ExactFollower::explained_by_lags(const JointVector& error) const {
  return (error.array().abs() <= options_.lag * phi_.array().abs() + kAnyError).all();
}

/// Whether an error that no lag explains is less than two seconds old.
bool ExactFollower::in_doubt() const { return settling_ > kSettling; }

/// Gradually: hard braking would bend the path of the joints.
void ExactFollower::pace_flange() {
  const double rate = (1 - kSlowFlange) * (in_doubt() ? -1 / kSlowing : 1 / kHastening);
  flange_share_ = std::clamp(flange_share_ + options_.T * rate, kSlowFlange, 1.0);
}

void ExactFollower::adapt_lags(const JointVector& error) {
  for (Eigen::Index i = 0; i < lag_.size(); ++i) {
    const double step = error[i] * phi_[i] / (phi_[i] * phi_[i] + kPhiFloor * kPhiFloor);
    // A value that is not finite leaves the lag unchanged.
    const double moved = lag_[i] + options_.learning * options_.T * step;
    if (moved > 0 && moved < kMaxLagRatio * options_.lag) lag_[i] = moved;
  }
}

double ExactFollower::tracking_error(const JointVector& q) const {
  const JointVector& then =
      n_late_ == 0 ? q_ref_ : history_[(newest_ + kHistory - n_late_ + 1) % kHistory].q;
  return (then - q).cwiseAbs().maxCoeff();
}

}  // namespace surg
