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
  phi_.setZero(q.size());
}

JointVector ExactFollower::advance(const JointVector& dq, const JointVector& q) {
  const JointVector v = dq / options_.T;
  const JointVector a = (v - v_last_) / options_.T;
  const JointVector error = q_ref_ - q;
  const JointVector qd = v + lag_.cwiseProduct(a) + options_.gain * error;
  learn(a, error);
  q_ref_ += dq;
  v_last_ = v;
  return qd;
}

void ExactFollower::learn(const JointVector& a, const JointVector& error) {
  phi_ += options_.T * (a - options_.gain * phi_);
  for (Eigen::Index i = 0; i < lag_.size(); ++i) {
    const double step = error[i] * phi_[i] / (phi_[i] * phi_[i] + kQuietPhi * kQuietPhi);
    // Written so that what is not finite leaves the lag as it was.
    const double moved = lag_[i] + options_.learning * options_.T * step;
    if (moved > 0 && moved < kMostLag * options_.lag) lag_[i] = moved;
  }
}

double ExactFollower::behind(const JointVector& q) const {
  return (q_ref_ - q).cwiseAbs().maxCoeff();
}

}  // namespace surg
