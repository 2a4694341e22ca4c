#include "surg_core/exact_follower.hpp"

#include <algorithm>

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
  correction_.setZero(q.size());
  phi_.setZero(q.size());
}

JointVector ExactFollower::advance(const JointVector& dq, const JointVector& q) {
  const JointVector v = dq / options_.T;
  for (Eigen::Index i = 0; i < q_ref_.size(); ++i) {
    const double a = (v[i] - v_last_[i]) / options_.T;
    const double error = q_ref_[i] - q[i];
    const double wanted = lag_[i] * a + options_.gain * error;
    correction_[i] = bounded(i, wanted);
    phi_[i] += options_.T * (a - options_.gain * phi_[i]);
    // An error that the bounds have left says nothing about the lag.
    if (correction_[i] == wanted) learn(i, error);
  }
  q_ref_ += dq;
  v_last_ = v;
  return v + correction_;
}

double ExactFollower::bounded(Eigen::Index i, double wanted) const {
  if (options_.acceleration.size() > i) {
    const double slope = options_.acceleration[i] * options_.T;
    wanted = std::clamp(wanted, correction_[i] - slope, correction_[i] + slope);
  }
  if (options_.velocity.size() > i) {
    wanted = std::clamp(wanted, -options_.velocity[i], options_.velocity[i]);
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
