#include "surg_core/kinematics/breathing_filter.hpp"

#include <cmath>

namespace surg {
namespace {

constexpr double kWander = 1e-5;     // [m/sqrt(s)] of the mean; of the k-th harmonic 1/k of it
constexpr double kDrift = 1e-6;      // [m/s/sqrt(s)] of the line's slope
constexpr double kStart = 4;         // times the covariance of a fit whose rate is right
constexpr double kProven = 8;        // [s] after which a rate that fails was right before
constexpr double kBiasShare = 0.15;  // of a new innovation in the low-passed one
constexpr double kDeparture = 5.5;   // its standard deviations; beyond them the motion has changed

}  // namespace

void BreathingFilter::start(const Vector3& p, double variance) {
  settled_ = false;
  since_ = 0;
  search_.clear();
  search_.add(p, 0, variance);
}

void BreathingFilter::predict(double dt) {
  since_ += dt;
  if (!settled_) return;
  settled_for_ += dt;
  phase_ = std::remainder(phase_ + rate_ * dt, 2 * M_PI);
  x_.row(0) += dt * x_.row(1);
  P_.row(0) += dt * P_.row(1);
  P_.col(0) += dt * P_.col(1);
  P_(0, 0) += kWander * kWander * dt;
  P_(1, 1) += kDrift * kDrift * dt;
  for (int i = 2; i < Harmonics::kTerms; ++i) {
    const double wander = kWander / (i / 2);
    P_(i, i) += wander * wander * dt;
  }
}

void BreathingFilter::measure(const Vector3& p, double variance) {
  search_.add(p, since_, variance);
  since_ = 0;
  if (settled_) {
    const Vector3 miss = p - this->p();
    if (departs(miss, variance)) return drop(p, variance);
    correct(miss, variance);
    if (search_.found()) rate_ = search_.rate();
  } else if (search_.found()) {
    settle();
  }
}

void BreathingFilter::settle() {
  const RateSearch::Fit fit = search_.fit();
  settled_ = true;
  settled_for_ = 0;
  rate_ = fit.rate;
  phase_ = 0;
  x_ = fit.x;
  P_ = kStart * fit.covariance;
  bias_.setZero();
}

/// A filter that was right for a while tells that the breathing has changed; else its rate is
/// wrong.
void BreathingFilter::drop(const Vector3& p, double variance) {
  if (settled_for_ > kProven) return start(p, variance);
  settled_ = false;
  search_.reject();
}

/// A bias of the innovations shows a change within a few samples: a shift, a cough, an apnoea.
bool BreathingFilter::departs(const Vector3& miss, double variance) {
  const Harmonics::Row row = Harmonics::row(phase_, 0);
  bias_ += kBiasShare * (miss - bias_);
  const double of_bias = kBiasShare / (2 - kBiasShare) * (row.dot(P_ * row) + variance);
  return bias_.squaredNorm() > kDeparture * kDeparture * of_bias;
}

void BreathingFilter::correct(const Vector3& miss, double variance) {
  const Harmonics::Row row = Harmonics::row(phase_, 0);
  const Harmonics::Row column = P_ * row;
  const double total = row.dot(column) + variance;
  const Harmonics::Row gain = column / total;
  x_ += gain * miss.transpose();
  P_ -= total * gain * gain.transpose();
}

Vector3 BreathingFilter::p(double ahead) const {
  return x_.transpose() * Harmonics::row(phase_ + rate_ * ahead, ahead);
}

Vector3 BreathingFilter::v(double ahead) const {
  return x_.transpose() * Harmonics::derivative(phase_ + rate_ * ahead, rate_);
}

}  // namespace surg
