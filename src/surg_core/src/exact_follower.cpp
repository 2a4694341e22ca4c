#include "surg_core/exact_follower.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kMostLag = 3;       // learnt lag over stated lag
constexpr double kQuietPhi = 0.003;  // [rad/s] below it an error says little about the lag

}  // namespace

ExactFollower::ExactFollower(int joints, const Options& options)
    : options_(options), lag_(JointVector::Constant(joints, options.lag)) {
  reset(JointVector::Zero(joints));
}

void ExactFollower::reset(const JointVector& q) {
  q_ref_ = q;
  v_last_.setZero(q.size());
  qd_last_.setZero(q.size());
  phi_.setZero(q.size());
}

JointVector ExactFollower::advance(const JointVector& dq, const JointVector& q) {
  const JointVector v = dq / options_.T;
  for (Eigen::Index i = 0; i < q_ref_.size(); ++i) {
    const double a = (v[i] - v_last_[i]) / options_.T;
    const double error = q_ref_[i] - q[i];
    const double pull = feedback(i, error);
    const double wanted = v[i] + lag_[i] * a + pull;
    qd_last_[i] = bounded(i, wanted);
    phi_[i] += options_.T * (a - options_.gain * phi_[i]);
    // An error that the limits have left says nothing about the lag.
    if (qd_last_[i] == wanted && pull == options_.gain * error) learn(i, error);
  }
  q_ref_ += dq;
  v_last_ = v;
  return qd_last_;
}

double ExactFollower::feedback(Eigen::Index i, double error) const {
  const double linear = options_.gain * error;
  if (options_.acceleration.size() <= i || options_.gain <= 0) return linear;
  const double a = 0.5 * options_.acceleration[i], bend = a / (options_.gain * options_.gain);
  if (!(std::abs(error) > bend)) return linear;
  return std::copysign(std::sqrt(a * (2 * std::abs(error) - bend)), error);  // same slope there
}

double ExactFollower::bounded(Eigen::Index i, double wanted) const {
  if (options_.velocity.size() > i) {
    wanted = std::clamp(wanted, -options_.velocity[i], options_.velocity[i]);
  }
  if (options_.acceleration.size() > i) {
    const double change = options_.acceleration[i] * options_.T * (1 - 1e-9);  // for rounding
    wanted = std::clamp(wanted, qd_last_[i] - change, qd_last_[i] + change);
  }
  return wanted;
}

void ExactFollower::learn(Eigen::Index i, double error) {
  const double step = error * phi_[i] / (phi_[i] * phi_[i] + kQuietPhi * kQuietPhi);
  // Written so that what is not finite leaves the lag as it was.
  const double moved = lag_[i] + options_.learning * options_.T * step;
  if (moved > 0 && moved < kMostLag * options_.lag) lag_[i] = moved;
}

double ExactFollower::behind(const JointVector& q) const {
  return (q_ref_ - q).cwiseAbs().maxCoeff();
}

}  // namespace surg
