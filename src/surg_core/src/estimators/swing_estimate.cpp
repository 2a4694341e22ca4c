#include "surg_core/estimators/swing_estimate.hpp"

#include <cmath>

#include "surg_core/estimators/motion_model.hpp"
#include "surg_core/estimators/oscillator.hpp"

namespace surg {

SwingEstimate::SwingEstimate(const SwingModel& model) : model_(model) {
  const double omega = 2 * M_PI * model.hertz;
  stiffness_ = omega * omega + model.fade * model.fade;
  state_.fill(Mixed::Zero());
}

void SwingEstimate::reset(const Values& x) {
  for (int i = 0; i < StreamEstimate::kDof; ++i) {
    state_[i].setZero();
    state_[i][0] = x[i];
  }
  Mixed variances;
  variances << 1 + model_.size, motion_model::kFirstVelocity,
      0.5 * motion_model::kJerkDensity / model_.return_decay, model_.size, stiffness_ * model_.size;
  covariance_ = variances.asDiagonal();
}

SwingEstimate::Values SwingEstimate::update(const Values& x, double elapsed) {
  const Covariance F = transition(elapsed);
  covariance_ = (F * covariance_ * F.transpose() + process(F, elapsed)).eval();
  const Mixed with_sample = covariance_.col(0) + covariance_.col(3);
  const Mixed gain = with_sample / (with_sample[0] + with_sample[3] + model_.noise);
  Values off{};
  for (int i = 0; i < StreamEstimate::kDof; ++i) {
    state_[i] = (F * state_[i]).eval();
    off[i] = x[i] - state_[i][0] - state_[i][3];
    state_[i] += off[i] * gain;
  }
  covariance_ -= gain * with_sample.transpose();
  covariance_ = (0.5 * (covariance_ + covariance_.transpose())).eval();  // rounding adds up
  return off;
}

SwingEstimate::Covariance SwingEstimate::transition(double h) const {
  const double k = model_.return_rate, c = model_.return_decay;
  const Eigen::Matrix2d slow = oscillation(k, 0.5 * c, h);
  Covariance F = Covariance::Zero();
  F(0, 0) = 1;
  // Of a' = -k v - c a the integral over h.
  F(0, 1) = -(slow(1, 0) + c * (slow(0, 0) - 1)) / k;
  F(0, 2) = -(slow(1, 1) - 1 + c * slow(0, 1)) / k;
  F.block<2, 2>(1, 1) = slow;
  if (model_.size > 0) F.bottomRightCorner<2, 2>() = oscillation(stiffness_, model_.fade, h);
  return F;
}

/// What noise adds over h: to the motion by its jerk, to the swing what has faded of it.
SwingEstimate::Covariance SwingEstimate::process(const Covariance& F, double h) const {
  Covariance Q = Covariance::Zero();
  Q.topLeftCorner<3, 3>() = jerk_noise(motion_model::kJerkDensity, h);
  Q.bottomRightCorner<2, 2>() =
      oscillation_noise(F.bottomRightCorner<2, 2>(), model_.size, stiffness_);
  return Q;
}

SwingEstimate::State SwingEstimate::predict(double age) const {
  const Covariance F = transition(age);
  State out;
  for (int i = 0; i < StreamEstimate::kDof; ++i) {
    const Mixed z = F * state_[i];
    out[i] = {z[0] + z[3], z[1] + z[4], z[2] - 2 * model_.fade * z[4] - stiffness_ * z[3]};
  }
  return out;
}

}  // namespace surg
