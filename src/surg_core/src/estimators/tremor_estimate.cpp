#include "surg_core/estimators/tremor_estimate.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/estimators/motion_model.hpp"
#include "surg_core/estimators/oscillator.hpp"

namespace surg {
namespace {

// In units of a sample's variance. Tuned for gains below 0.5 at 8 to 12 Hz and 1.05 up to 3 Hz, at
// the least lag for samples of 25 to 500 Hz.
constexpr double kJerk = 1.1e12;           // [1/s^5] spectral density of the motion's jerk
constexpr double kTremorVariance = 2.4e4;  // variance of the tremor
constexpr double kDecay = 14;              // [1/s] with which an oscillation of the tremor fades
constexpr double kLate = 0.016;            // [s] that the slow motion is asked for late
constexpr double kLatePeriods = 0.81;      // periods that it is asked for late besides
constexpr double kFirst = 1e10;  // [1, 1/s^4] variance of position and acceleration at the start

}  // namespace

TremorEstimate::TremorEstimate(double centre) : omega_(2 * M_PI * centre) {
  state_.fill(Mixed::Zero());
}

double TremorEstimate::late(double period) { return kLate + kLatePeriods * period; }

void TremorEstimate::reset(const Values& x) {
  for (int i = 0; i < StreamEstimate::kDof; ++i) {
    state_[i].setZero();
    state_[i][0] = x[i];
  }
  Mixed variances;
  variances << kFirst, motion_model::kFirstVelocity, kFirst, kTremorVariance,
      omega_ * omega_ * kTremorVariance;
  covariance_ = variances.asDiagonal();
  take(x);
}

void TremorEstimate::update(const Values& x, double elapsed) {
  if (!(elapsed < motion_model::kLongestGap)) {
    reset(x);
    return;
  }
  const double h = std::max(elapsed, 0.0);
  const Covariance F = transition(h);
  for (Mixed& state : state_) state = (F * state).eval();
  covariance_ = (F * covariance_ * F.transpose() + process(F, h)).eval();
  take(x);
}

void TremorEstimate::take(const Values& x) {
  const Mixed with_sample = covariance_.col(0) + covariance_.col(3);
  const Mixed gain = with_sample / (with_sample[0] + with_sample[3] + 1);
  for (int i = 0; i < StreamEstimate::kDof; ++i) {
    state_[i] += (x[i] - state_[i][0] - state_[i][3]) * gain;
  }
  covariance_ -= gain * with_sample.transpose();
}

TremorEstimate::Covariance TremorEstimate::transition(double h) const {
  Covariance F = Covariance::Identity();
  F(0, 1) = F(1, 2) = h;
  F(0, 2) = 0.5 * h * h;
  F.bottomRightCorner<2, 2>() = oscillation(omega_ * omega_, kDecay, h);
  return F;
}

/// What noise adds over h: to the motion by its jerk, to the tremor what has faded of it.
TremorEstimate::Covariance TremorEstimate::process(const Covariance& F, double h) const {
  Covariance Q = Covariance::Zero();
  Q.topLeftCorner<3, 3>() = jerk_noise(kJerk, h);
  Q.bottomRightCorner<2, 2>() =
      oscillation_noise(F.bottomRightCorner<2, 2>(), kTremorVariance, omega_ * omega_);
  return Q;
}

TremorEstimate::State TremorEstimate::predict(double age) const {
  State out;
  for (int i = 0; i < StreamEstimate::kDof; ++i) {
    const double x = state_[i][0], v = state_[i][1], a = state_[i][2];
    out[i] = {x + age * (v + 0.5 * age * a), v + age * a, a};
  }
  return out;
}

}  // namespace surg
