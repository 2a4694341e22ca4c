#include "surg_core/estimators/breathing_filter.hpp"

#include <algorithm>
#include <cmath>
#include <complex>

namespace surg {
namespace {

constexpr double kWander = 1e-5;     // [m/sqrt(s)] of the mean; of the k-th harmonic 1/k of it
constexpr double kDrift = 1e-6;      // [m/s/sqrt(s)] of the line's slope
constexpr double kStart = 4;         // times the covariance of a fit whose rate is right
constexpr double kBiasShare = 0.15;  // of a new innovation in the low-passed one
constexpr double kDeparture = 5.5;   // its standard deviations; beyond them the motion has changed
constexpr double kFinest = 2.4;      // [Hz] of the overtones; the wall is too heavy for faster ones
constexpr double kLearning = 0.25;   // of a breath: time constant of an overtone at the least
constexpr double kKink = 1.2;        // times the fundamental over k^2: what a kink adds

}  // namespace

void Overtones::start(double rate, double size) {
  const int last = std::min(static_cast<int>(2 * M_PI * kFinest / rate), kLast);
  n_ = std::max(last - kFirstOvertone + 1, 0);
  rate_ = rate;
  breath_ = 0;
  for (int i = 0; i < n_; ++i) {
    const double k = kFirstOvertone + i, deviation = kKink * size / (k * k);
    cos_[i].setZero();
    sin_[i].setZero();
    variance_[i] = deviation * deviation;
  }
}

void Overtones::predict(double dt) {
  breath_ += dt * rate_ / (2 * M_PI);
  for (int i = 0; i < n_; ++i) {
    const double wander = kWander / (kFirstOvertone + i);
    variance_[i] += wander * wander * dt;
  }
}

void Overtones::correct(double phase, const Vector3& miss, double variance) {
  const std::complex<double> turn = std::polar(1.0, phase);
  std::complex<double> at = std::polar(1.0, (kFirstOvertone - 1) * phase);
  for (int i = 0; i < n_; ++i) {
    at *= turn;
    // The samples of a small part of a breath cannot tell one overtone from the next.
    const double slowly = 0.5 * kLearning * variance_[i] / breath_;
    const double gain = variance_[i] / std::max(variance, slowly);
    cos_[i] += gain * at.real() * miss;
    sin_[i] += gain * at.imag() * miss;
    variance_[i] -= 0.5 * gain * variance_[i];  // cosine and sine see half of the samples each
  }
  breath_ = 0;
}

Vector3 Overtones::p(double phase) const {
  const std::complex<double> turn = std::polar(1.0, phase);
  std::complex<double> at = std::polar(1.0, (kFirstOvertone - 1) * phase);
  Vector3 p = Vector3::Zero();
  for (int i = 0; i < n_; ++i) {
    at *= turn;
    p += at.real() * cos_[i] + at.imag() * sin_[i];
  }
  return p;
}

Vector3 Overtones::v(double phase, double rate) const {
  const std::complex<double> turn = std::polar(1.0, phase);
  std::complex<double> at = std::polar(1.0, (kFirstOvertone - 1) * phase);
  Vector3 v = Vector3::Zero();
  for (int i = 0; i < n_; ++i) {
    at *= turn;
    v += (kFirstOvertone + i) * rate * (at.real() * sin_[i] - at.imag() * cos_[i]);
  }
  return v;
}

double Overtones::variance() const {
  double sum = 0;
  for (int i = 0; i < n_; ++i) sum += variance_[i];
  return sum;
}

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
  overtones_.predict(dt);
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
  overtones_.start(rate_, std::sqrt(x_.row(2).squaredNorm() + x_.row(3).squaredNorm()));
  bias_.setZero();
}

/// A filter that was right for a while tells that the breathing has changed; else its rate is
/// wrong.
void BreathingFilter::drop(const Vector3& p, double variance) {
  if (settled_for_ > RateSearch::kLeastSpan) return start(p, variance);
  settled_ = false;
  search_.reject();
}

/// A bias of the innovations shows a change within a few samples: a shift, a cough, an apnoea.
bool BreathingFilter::departs(const Vector3& miss, double variance) {
  const Harmonics::Row row = Harmonics::row(phase_, 0);
  bias_ += kBiasShare * (miss - bias_);
  const double of_miss = row.dot(P_ * row) + overtones_.variance() + variance;
  const double of_bias = kBiasShare / (2 - kBiasShare) * of_miss;
  return bias_.squaredNorm() > kDeparture * kDeparture * of_bias;
}

void BreathingFilter::correct(const Vector3& miss, double variance) {
  const Harmonics::Row row = Harmonics::row(phase_, 0);
  const Harmonics::Row column = P_ * row;
  const double total = row.dot(column) + overtones_.variance() + variance;
  const Harmonics::Row gain = column / total;
  x_ += gain * miss.transpose();
  P_ -= total * gain * gain.transpose();
  overtones_.correct(phase_, miss, total);
}

Vector3 BreathingFilter::p(double ahead) const {
  const double phase = phase_ + rate_ * ahead;
  return x_.transpose() * Harmonics::row(phase, ahead) + overtones_.p(phase);
}

Vector3 BreathingFilter::v(double ahead) const {
  const double phase = phase_ + rate_ * ahead;
  return x_.transpose() * Harmonics::derivative(phase, rate_) + overtones_.v(phase, rate_);
}

}  // namespace surg
