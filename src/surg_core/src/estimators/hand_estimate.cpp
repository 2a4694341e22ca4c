#include "surg_core/estimators/hand_estimate.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/estimators/motion_model.hpp"

namespace surg {
namespace {

// Tuned at 30 Hz on synthetic hands with tremors of one frequency, of a narrow and of a wide band,
// on the first half of a recorded motion, and on sines at 60 to 500 Hz (docs/design/set_points.md).
constexpr SwingModel kReturning{2.3, 223, 1.7};  // a motion that comes back
constexpr SwingModel kTremor{2500, 44, 0.17, 0, 1800, 2};
constexpr double kTremorHertz[] = {8, 9, 10, 11, 12};
constexpr SwingModel kSwing{2500, 44, 0.17, 0, 1e9, 0.75};
constexpr double kSwingHertz[] = {3, 3.5, 4.1, 4.8, 5.7, 6.8};
// Weights before any sample is known, beside that of a motion that comes back.
constexpr double kPlain = 2;               // weight of the plain model, at the rate that follows
constexpr double kPlainPeriod = 1 / 30.0;  // [s] at shorter ones it grows with their square
constexpr double kTremorPrior = 0.19;      // weight of each tremor
constexpr double kSwingPrior = 0.2;        // weight of each swing
constexpr double kMemory = 0.4;            // [s] over which innovations are compared
constexpr double kLeast = 1e-18;  // [m^2, rad^2] a difference of innovations that says nothing
// Over a shorter time no model errs enough to be told from another: one that has the acceleration
// wrong was followed for 0.3 s at 500 Hz.
constexpr double kSpacing = 0.0079;  // [s] between the samples that the swings are given
constexpr double kLateBy = 0.03;     // of a period: a smoother path

double prior(std::size_t swing) {
  return swing == 0 ? 1.0 : swing <= std::size(kTremorHertz) ? kTremorPrior : kSwingPrior;
}

}  // namespace

HandEstimate::HandEstimate() {
  auto next = swings_.begin();
  *next++ = SwingEstimate(kReturning);
  const auto add = [&next](SwingModel model, double hertz) {
    model.hertz = hertz;
    *next++ = SwingEstimate(model);
  };
  for (const double hertz : kTremorHertz) add(kTremor, hertz);
  for (const double hertz : kSwingHertz) add(kSwing, hertz);
  static_assert(1 + std::size(kTremorHertz) + std::size(kSwingHertz) == kSwings);
}

double HandEstimate::late(double period) { return kLateBy * period; }

void HandEstimate::reset(const Values& x) {
  plain_.reset(x);
  since_ = 0;
  swinging_ = false;
}

void HandEstimate::begin_swings(const Values& x) {
  for (SwingEstimate& swing : swings_) swing.reset(x);
  for (Values& error : errors_) error.fill(0);
  swinging_ = true;
}

void HandEstimate::update(const Values& x, double elapsed, double period) {
  since_ += std::max(elapsed, 0.0);
  plain_.update(x, elapsed, period);
  if (swinging_ && since_ < kSpacing) return;
  const double h = since_;
  since_ = 0;
  if (swinging_ && h < motion_model::kLongestGap) {
    compare(x, h);
  } else {
    begin_swings(x);
  }
  then_ = plain_;
  weigh(period);
}

/// What every model predicted of a sample, h seconds after the last one that all were given.
void HandEstimate::compare(const Values& x, double h) {
  std::array<Values, kSwings + 1> off{};
  const State expected = then_.predict(h);
  for (int i = 0; i < kDof; ++i) off[kSwings][i] = x[i] - expected[i].x;
  for (int k = 0; k < kSwings; ++k) off[k] = swings_[k].update(x, h);
  const double kept = std::exp(-h / kMemory);
  for (int k = 0; k <= kSwings; ++k) {
    for (int i = 0; i < kDof; ++i) errors_[k][i] = kept * errors_[k][i] + off[k][i] * off[k][i];
  }
}

/// The likelihood of n samples with an unknown common variance goes with the power -n / 2 of the
/// sum of the squared innovations; n are about 10.
void HandEstimate::weigh(double period) {
  const double often = kPlainPeriod / std::max(period, kSpacing), plain = kPlain * often * often;
  for (int i = 0; i < kDof; ++i) {
    double least = errors_[kSwings][i], sum = 0;
    for (const Values& error : errors_) least = std::min(least, error[i]);
    for (std::size_t k = 0; k <= kSwings; ++k) {
      const double ratio = (least + kLeast) / (errors_[k][i] + kLeast), square = ratio * ratio;
      const double weight = k == kSwings ? plain : prior(k);
      sum += weights_[k][i] = weight * square * square * ratio;
    }
    for (Values& weight : weights_) weight[i] /= sum;
  }
}

HandEstimate::State HandEstimate::predict(double age) const {
  State out = plain_.predict(age);
  if (!swinging_) return out;
  for (int i = 0; i < kDof; ++i) {
    const double weight = weights_[kSwings][i];
    out[i].x *= weight;
    out[i].v *= weight;
    out[i].a *= weight;
  }
  for (int k = 0; k < kSwings; ++k) {
    const State swing = swings_[k].predict(since_ + age);
    for (int i = 0; i < kDof; ++i) {
      const double weight = weights_[k][i];
      out[i].x += weight * swing[i].x;
      out[i].v += weight * swing[i].v;
      out[i].a += weight * swing[i].a;
    }
  }
  return out;
}

}  // namespace surg
