#include "surg_core/estimators/track_filter.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kJerkChange = 0.1;          // [s] in which the jerk changes by its stated size
constexpr double kLeastNoise = 5e-6;         // [m] rms; no tracker is better
constexpr double kLeastRateNoise = 4e-4;     // [m/s] rms; trackers low-pass their velocities
constexpr double kStartSpeed = 0.01;         // [m/s] standard deviation at the first sample
constexpr double kStartAcceleration = 0.02;  // [m/s^2] standard deviation at the first sample
constexpr double kGate = 5;          // standard deviations; beyond them a sample is an outlier
constexpr double kLeastGate = 1e-3;  // [m] a pushed trocar leaves the model by as much
constexpr double kRateGate = 0.005;  // [m/s] of a velocity, which is then not used
constexpr double kBeside = 4;  // standard deviations of a difference of samples; beyond: an outlier
constexpr double kMemory = 2;  // [s] in which the filters are compared
constexpr int kNoiseMemory = 100;  // samples of which the noise is estimated
constexpr int kStatedNoise = 3;    // samples that the stated noise counts for

double squared(double x) { return x * x; }

}  // namespace

void PointKalman::start(const Vector3& p, const Vector3& v, const Matrix3& covariance) {
  p_ = p;
  v_ = v;
  a_.setZero();
  P_ = covariance;
}

void PointKalman::predict(double dt, double jerk) {
  p_ = p(dt);
  v_ = v(dt);
  Matrix3 F = Matrix3::Identity();
  F(0, 1) = F(1, 2) = dt;
  F(0, 2) = 0.5 * dt * dt;
  const double t2 = dt * dt, t3 = t2 * dt;
  Matrix3 Q;
  Q << t2 * t3 / 20, t2 * t2 / 8, t3 / 6, t2 * t2 / 8, t3 / 3, t2 / 2, t3 / 6, t2 / 2, dt;
  P_ = F * P_ * F.transpose() + jerk * Q;
}

void PointKalman::measure(int row, const Vector3& value, double variance) {
  const double total = P_(row, row) + variance;
  const Vector3 gain = P_.col(row) / total;
  const Vector3 miss = value - (row == 0 ? p_ : v_);
  p_ += gain[0] * miss;
  v_ += gain[1] * miss;
  a_ += gain[2] * miss;
  P_ -= total * gain * gain.transpose();
}

void NoiseEstimate::add(const Vector3& sample, bool evenly) {
  if (!evenly) n_ = 0;
  if (n_ == 3) {
    const Vector3 difference = (sample - third_) - 2 * (third_ - second_) + (second_ - first_);
    // Of three axes; white noise gives 1 + 9 + 9 + 1 times the variance of a sample.
    const double seen = difference.squaredNorm() / (3 * 20);
    known_ = std::min(known_ + 1, kNoiseMemory);
    variance_ += (std::min(seen, squared(kBeside) * variance_) - variance_) / known_;
  }
  first_ = second_;
  second_ = third_;
  third_ = sample;
  n_ = std::min(n_ + 1, 3);
}

TrackFilter::TrackFilter(double noise, double jerk, double speed)
    : jerk_(jerk * jerk * kJerkChange),
      speed_(speed),
      position_noise_(squared(noise), kStatedNoise),
      velocity_noise_(squared(kStartSpeed), 0) {}

void TrackFilter::start(const Vector3& p, const Vector3& v) {
  const Vector3 variances(position_variance(), squared(kStartSpeed), squared(kStartAcceleration));
  positions_.start(p, Vector3::Zero(), variances.asDiagonal());
  both_ = positions_;
  breathing_.start(p, position_variance());
  miss_both_ = miss_positions_ = miss_breathing_ = 0;
  last_ = p;
  took_last_ = true;
  position_noise_.add(p, false);
  velocity_noise_.add(v, false);
  both_.measure_velocity(v, std::max(velocity_noise_.variance(), squared(kLeastRateNoise)));
}

double TrackFilter::position_variance() const {
  return std::max(position_noise_.variance(), squared(kLeastNoise));
}

bool TrackFilter::add(const Vector3& p, const Vector3& v, double dt, bool evenly) {
  both_.predict(dt, jerk_);
  positions_.predict(dt, jerk_);
  breathing_.predict(dt);
  const double variance = position_variance();
  const bool beside =
      evenly && took_last_ && (p - last_).norm() <= speed_ * dt + kBeside * std::sqrt(2 * variance);
  took_last_ = beside || expected(p, variance);
  if (!took_last_) return false;
  last_ = p;
  position_noise_.add(p, evenly);
  velocity_noise_.add(v, evenly);
  compare(p, 1 - std::exp(-dt / kMemory));
  breathing_.measure(p, variance);
  positions_.measure_position(p, variance);
  both_.measure_position(p, variance);
  const double rate_variance = std::max(velocity_noise_.variance(), squared(kLeastRateNoise));
  const double rate_gate = kRateGate + kGate * std::sqrt(both_.velocity_variance() + rate_variance);
  if ((v - both_.v()).norm() <= rate_gate) both_.measure_velocity(v, rate_variance);
  return true;
}

/// Near the prediction of one of the filters.
bool TrackFilter::expected(const Vector3& p, double variance) const {
  double miss = std::min((p - both_.p()).norm(), (p - positions_.p()).norm());
  if (breathing_.settled()) miss = std::min(miss, (p - breathing_.p()).norm());
  return miss <= gate(std::sqrt(positions_.position_variance() + variance));
}

void TrackFilter::compare(const Vector3& p, double share) {
  miss_both_ += share * ((p - both_.p()).squaredNorm() - miss_both_);
  miss_positions_ += share * ((p - positions_.p()).squaredNorm() - miss_positions_);
  if (breathing_.settled()) {
    miss_breathing_ += share * ((p - breathing_.p()).squaredNorm() - miss_breathing_);
  } else {
    miss_breathing_ = std::min(miss_both_, miss_positions_);
  }
}

double TrackFilter::velocity_deviation() const { return std::sqrt(best().velocity_variance()); }

double TrackFilter::noise() const { return std::sqrt(position_noise_.variance()); }

double TrackFilter::gate(double deviation) { return std::max(kGate * deviation, kLeastGate); }

}  // namespace surg
