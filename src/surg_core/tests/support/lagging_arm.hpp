// An arm that obeys late, for the tests of laws that have to live with that.
#pragma once

#include <cmath>

#include "surg_core/types.hpp"
#include "test_support.hpp"

namespace surg::test {

/// Joints that follow a velocity command after one tick (2 ms) of delay through a first-order lag
/// of their own, integrated exactly; measured in steps of 1e-5 rad.
class LaggingArm {
 public:
  LaggingArm(const JointVector& q, Random& random, double shortest = 0.008, double longest = 0.012)
      : q_(q) {
    const Eigen::Index n = q.size();
    qd_.setZero(n);
    waiting_.setZero(n);
    tau_.resize(n);
    for (Eigen::Index i = 0; i < n; ++i) tau_[i] = random.uniform(shortest, longest);
  }
  /// With these first-order lags [s].
  LaggingArm(const JointVector& q, const JointVector& tau) : q_(q), tau_(tau) {
    qd_ = waiting_ = JointVector::Zero(q.size());
  }
  /// Each joint's first-order lag [s].
  const JointVector& tau() const { return tau_; }
  const JointVector& truth() const { return q_; }
  JointVector measured() const { return (q_ / kStep).array().round().matrix() * kStep; }
  void obey(const JointVector& command) {
    for (Eigen::Index i = 0; i < q_.size(); ++i) {
      const double keep = std::exp(-kTick / tau_[i]), u = waiting_[i];
      q_[i] += kTick * u + tau_[i] * (1 - keep) * (qd_[i] - u);
      qd_[i] = u + keep * (qd_[i] - u);
    }
    waiting_ = command;
  }

 private:
  static constexpr double kTick = 0.002;  // [s]
  static constexpr double kStep = 1e-5;   // [rad]
  JointVector q_, qd_, waiting_, tau_;
};

}  // namespace surg::test
