#include "surg_core/estimators/stream_estimate.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/estimators/motion_model.hpp"

namespace surg {
namespace {

// Tuned on a synthetic and a recorded hand motion (docs/results/stream.md).
constexpr double kAccelerationMemory = 0.08;  // [s] time constant of the acceleration
// At a slow rate more of a hand's motion is beyond prediction and counts as noise.
constexpr double kNoisyPeriod = 0.0035;  // [s] above it a sample's variance grows with its cube

}  // namespace

/// x += v_x v + a_x a, v += a_v a, a *= a_a.
struct StreamEstimate::Transition {
  explicit Transition(double time) {
    if (time <= 0) {  // back in time nothing decays: a sample's recent past is known
      v_x = a_v = time;
      a_x = 0.5 * time * time;
      return;
    }
    a_a = std::exp(-time / kAccelerationMemory);
    v_x = time;
    a_v = kAccelerationMemory * (1 - a_a);
    a_x = kAccelerationMemory * (time - a_v);
  }
  Kinematic apply(const Kinematic& k) const {
    return {k.x + v_x * k.v + a_x * k.a, k.v + a_v * k.a, a_a * k.a};
  }
  double v_x, a_x, a_v, a_a = 1;
};

void StreamEstimate::reset(const Values& x) {
  for (int i = 0; i < kDof; ++i) state_[i] = {x[i], 0, 0};
  xx_ = 1;
  xv_ = xa_ = va_ = 0;
  vv_ = motion_model::kFirstVelocity;
  aa_ = 0.5 * motion_model::kJerkDensity * kAccelerationMemory;
}

void StreamEstimate::update(const Values& x, double elapsed, double period) {
  if (!(elapsed < motion_model::kLongestGap)) {
    reset(x);
    return;
  }
  const Transition step(std::max(elapsed, 0.0));
  propagate(step, std::max(elapsed, 0.0));
  const double slow = period / kNoisyPeriod;
  const double noise = 1 + slow * slow * slow;
  const double certainty = 1 / (xx_ + noise);
  const double gain_x = xx_ * certainty, gain_v = xv_ * certainty, gain_a = xa_ * certainty;
  for (int i = 0; i < kDof; ++i) {
    const Kinematic there = step.apply(state_[i]);
    const double innovation = x[i] - there.x;
    state_[i] = {there.x + gain_x * innovation, there.v + gain_v * innovation,
                 there.a + gain_a * innovation};
  }
  vv_ -= gain_v * xv_;
  va_ -= gain_v * xa_;
  aa_ -= gain_a * xa_;
  xx_ *= 1 - gain_x;
  xv_ *= 1 - gain_x;
  xa_ *= 1 - gain_x;
}

/// Covariance after 'elapsed': F P F' + Q, with Q of a constant acceleration and of its decay.
void StreamEstimate::propagate(const Transition& step, double elapsed) {
  const double h = elapsed, q = motion_model::kJerkDensity * std::min(h, 2 * kAccelerationMemory);
  const double with_v = xv_ + step.v_x * vv_ + step.a_x * va_;
  const double with_a = xa_ + step.v_x * va_ + step.a_x * aa_;
  const double v_with_a = va_ + step.a_v * aa_;
  xx_ += step.v_x * xv_ + step.a_x * xa_ + step.v_x * with_v + step.a_x * with_a +
         q * h * h * h * h / 20;
  xv_ = with_v + step.a_v * with_a + q * h * h * h / 8;
  xa_ = step.a_a * with_a + q * h * h / 6;
  vv_ += step.a_v * va_ + step.a_v * v_with_a + q * h * h / 3;
  va_ = step.a_a * v_with_a + q * h / 2;
  aa_ = step.a_a * step.a_a * aa_ +
        0.5 * motion_model::kJerkDensity * kAccelerationMemory * (1 - step.a_a * step.a_a);
}

StreamEstimate::State StreamEstimate::predict(double age) const {
  const Transition step(age);
  State out;
  for (int i = 0; i < kDof; ++i) out[i] = step.apply(state_[i]);
  return out;
}

}  // namespace surg
