#include "surg_core/motion/tremor_notch.hpp"

#include <cmath>

namespace surg {
namespace {

constexpr double kDamping = 0.6;    // half the width of the notch, relative to its centre
constexpr double kSubstep = 0.001;  // [s] of the integration

}  // namespace

TremorNotch::TremorNotch(double centre) : omega_(2 * M_PI * centre) {}

void TremorNotch::reset(const Kinematic& state) {
  out_ = state;
  // As after a motion at this velocity for ever: the output moves on without a jump.
  z_ = omega_ > 0 ? 2 * kDamping * state.x / omega_ : 0;
  z_rate_ = 0;
}

// y = x - b, where b = 2 d w s / (s^2 + 2 d w s + w^2) x is the band, and z its integral:
// z'' = 2 d w x - 2 d w z' - w^2 z.
void TremorNotch::step(const Kinematic& input, double T) {
  if (!works() || !(T > 0)) return;
  const double width = 2 * kDamping * omega_, square = omega_ * omega_;
  const int steps = static_cast<int>(std::ceil(T / kSubstep));
  const double h = T / steps;
  for (int i = 0; i < steps; ++i) {  // midpoint rule
    const double x0 = input.x - input.v * (T - i * h), x1 = x0 + input.v * h / 2;
    const double rate = z_rate_ + h / 2 * (width * (x0 - z_rate_) - square * z_);
    const double z = z_ + h / 2 * z_rate_;
    z_ += h * rate;
    z_rate_ += h * (width * (x1 - rate) - square * z);
  }
  const double band_rate = width * (input.x - z_rate_) - square * z_;
  const double band_change = width * (input.v - band_rate) - square * z_rate_;
  out_ = {input.x - z_rate_, input.v - band_rate, input.a - band_change};
}

Kinematic TremorNotch::predict(double ahead) const {
  return {out_.x + ahead * (out_.v + 0.5 * ahead * out_.a), out_.v + ahead * out_.a, out_.a};
}

}  // namespace surg
