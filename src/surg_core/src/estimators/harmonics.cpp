#include "surg_core/estimators/harmonics.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kBlock = 0.099;    // [s] samples are averaged over as much
constexpr double kSlowest = 0.09;   // [Hz] slowest rate of breathing
constexpr double kFastest = 0.6;    // [Hz] fastest rate of breathing
constexpr double kPeriods = 1.9;    // in the samples before a rate is believed
constexpr double kSweepStep = 0.2;  // periods in the span between two rates of the sweep
constexpr double kAlias = 3;        // times the least residual that a faster rate may leave
constexpr int kTries = 4;           // refinements, until the rate explains the motion
constexpr double kResidual = 1.4;   // times the noise's variance that a right rate may leave
constexpr double kShape = 3e-4;     // [m] rms that the harmonics may leave
constexpr double kRidge = 1e-6;     // times the samples; terms that the samples do not tell

double radians(double hertz) { return 2 * M_PI * hertz; }

}  // namespace

Harmonics::Row Harmonics::row(double phase, double t) {
  Row row;
  row[0] = 1;
  row[1] = t;
  const double c = std::cos(phase), s = std::sin(phase);
  double ck = 1, sk = 0;
  for (int k = 1; k <= kHarmonics; ++k) {
    const double next = ck * c - sk * s;
    sk = sk * c + ck * s;
    ck = next;
    row[2 * k] = ck;
    row[2 * k + 1] = sk;
  }
  return row;
}

Harmonics::Row Harmonics::derivative(double phase, double rate) {
  const Row at = row(phase, 0);
  Row slope;
  slope[0] = 0;
  slope[1] = 1;
  for (int k = 1; k <= kHarmonics; ++k) {
    slope[2 * k] = -k * rate * at[2 * k + 1];
    slope[2 * k + 1] = k * rate * at[2 * k];
  }
  return slope;
}

void RateSearch::clear() {
  n_ = in_block_ = 0;
  reject();
}

void RateSearch::reject() {
  swept_ = 0;
  rate_ = 0;
  found_ = false;
}

void RateSearch::add(const Vector3& p, double dt, double variance) {
  t_ += dt;
  if (in_block_ == 0) {
    block_from_ = t_;
    sum_t_ = 0;
    sum_.setZero();
  }
  sum_t_ += t_;
  sum_ += p;
  ++in_block_;
  if (t_ + dt - block_from_ < kBlock) return;
  const double explained = kResidual * variance / in_block_ + kShape * kShape;
  close_block();
  if (span() < kLeastSpan) return;
  for (int i = 0; i < kBlocks / n_; ++i) {
    if (rate_ > 0) {
      refine(explained);
    } else {
      sweep();
    }
  }
}

void RateSearch::close_block() {
  if (n_ == kBlocks) {
    first_ = (first_ + 1) % kBlocks;
    --n_;
  }
  ring_[(first_ + n_) % kBlocks] = {sum_t_ / in_block_, sum_ / in_block_};
  ++n_;
  in_block_ = 0;
}

RateSearch::Fit RateSearch::fit(double rate) const {
  Harmonics::Covariance A = Harmonics::Covariance::Zero();
  Harmonics::Coefficients B = Harmonics::Coefficients::Zero();
  double squares = 0;
  const Vector3 middle = block(n_ / 2).p;
  for (int i = 0; i < n_; ++i) {
    const double t = block(i).t - t_;
    const Harmonics::Row row = Harmonics::row(rate * t, t);
    const Vector3 y = block(i).p - middle;
    A.selfadjointView<Eigen::Lower>().rankUpdate(row);
    B += row * y.transpose();
    squares += y.squaredNorm();
  }
  A.diagonal().array() += kRidge * n_;
  const Eigen::LLT<Harmonics::Covariance, Eigen::Lower> factor(A);
  Fit fit;
  fit.rate = rate;
  fit.x = factor.solve(B);
  const double left = std::max(0.0, squares - fit.x.cwiseProduct(B).sum());
  fit.variance = left / (3.0 * (n_ - Harmonics::kTerms));
  fit.covariance = fit.variance * factor.solve(Harmonics::Covariance::Identity());
  fit.x.row(0) += middle.transpose();
  return fit;
}

void RateSearch::sweep() {
  const double step = radians(std::max(kSweepStep / span(), kFastest / kRates));
  const double rate = swept_ == 0 ? radians(kFastest) : swept_rate_[swept_ - 1] - step;
  const bool told = rate * span() >= radians(kPeriods);
  if (swept_ == kRates || rate < radians(kSlowest) || !told) {
    choose();
    swept_ = 0;
    return;
  }
  swept_rate_[swept_] = rate;
  swept_variance_[swept_] = fit(rate).variance;
  ++swept_;
}

/// The fastest rate that explains the motion; its half would explain it too.
void RateSearch::choose() {
  const auto& left = swept_variance_;
  const double least = *std::min_element(left.begin(), left.begin() + swept_);
  for (int i = 0; i < swept_; ++i) {
    const bool falls = i == 0 || left[i] <= left[i - 1];
    const bool rises = i + 1 == swept_ || left[i] <= left[i + 1];
    if (!falls || !rises || left[i] > kAlias * least) continue;
    rate_ = swept_rate_[i];
    probe_ = refined_ = 0;
    return;
  }
}

/// Newton's step to the least residual, from three rates.
void RateSearch::refine(double variance) {
  const double step = radians(0.5 * kSweepStep / span());
  probed_[probe_] = fit(rate_ + (probe_ - 1) * step).variance;
  if (++probe_ < 3) return;
  probe_ = 0;
  found_ = probed_[1] < variance;
  const double bend = probed_[0] - 2 * probed_[1] + probed_[2];
  const double slope = probed_[0] - probed_[2];
  const double shift = bend > 0 ? 0.5 * step * slope / bend : std::copysign(step, slope);
  rate_ = std::clamp(rate_ + std::clamp(shift, -step, step), radians(kSlowest), radians(kFastest));
  if (++refined_ >= kTries && !found_) reject();
}

}  // namespace surg
