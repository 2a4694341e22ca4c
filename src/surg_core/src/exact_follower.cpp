#include "surg_core/exact_follower.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kMostLag = 3;       // learnt lag over stated lag
constexpr double kQuietPhi = 0.003;  // [rad/s] below it an error says little about the lag

/// The largest factor up to 1 that keeps every joint inside its bound; empty bounds: 1.
double share(const JointVector& values, const JointVector& bounds) {
  double factor = 1;
  for (Eigen::Index i = 0; i < bounds.size(); ++i) {
    const double size = std::abs(values[i]);
    if (size > bounds[i]) factor = std::min(factor, bounds[i] / size);
  }
  return factor;
}

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
  const JointVector a = (v - v_last_) / options_.T;
  const JointVector error = q_ref_ - q;
  JointVector wanted = lag_.cwiseProduct(a) + options_.gain * error;
  // One factor for all joints, as everywhere: bounds that clip joint by joint move the pivot by
  // ten times as much.
  const double size = share(wanted, options_.velocity);
  wanted *= size;
  const JointVector change = wanted - correction_;
  const double slope = share(change, options_.T * options_.acceleration);
  correction_ += slope * change;
  phi_ += options_.T * (a - options_.gain * phi_);
  // An error that the bounds have left says nothing about the lags.
  if (size == 1 && slope == 1) learn(error);
  q_ref_ += dq;
  v_last_ = v;
  return v + correction_;
}

void ExactFollower::learn(const JointVector& error) {
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
