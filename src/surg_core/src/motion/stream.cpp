#include "surg_core/motion/stream.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

// Gains of the three nested loops, tuned on a synthetic and a recorded hand motion and on sines of
// every size (docs/results/stream.md), and the share of acceleration and jerk that the square-root
// approach counts on (the rest is left for the moving target: larger shares lock into swings from
// limit to limit). The gains are lower where ticks are long.
constexpr double kPositionGain = 45;              // [1/s] position to velocity
constexpr double kVelocityGain = 200;             // [1/s] velocity to acceleration
constexpr double kAccelerationGain = 800;         // [1/s] acceleration to jerk
constexpr double kFastestGain = 0.4;              // of the velocity loop, per tick
constexpr double kFedForward = 0.75;              // of the target's acceleration
constexpr double kJerkTime = 0.011;               // [s] of jerk that reaches what is fed forward
constexpr double kStreamAccelerationShare = 0.1;  // of the acceleration limit
constexpr double kJerkShare = 0.31;               // of the jerk limit

// After a late cycle, or where limits have slowed the clock.
constexpr double kLongestTick = 0.02;  // [s] that the filter follows

double clamp_to(double value, double bound) { return std::clamp(value, -bound, bound); }

// The rate at which an error e may be closed: proportional with gain g near zero, and from there on
// the speed from which a deceleration of l still stops in time.
double approach(double e, double g, double l) {
  const double magnitude = std::abs(e);
  if (magnitude <= l / (g * g)) return g * e;
  return std::copysign(std::sqrt(2 * l * (magnitude - 0.5 * l / (g * g))), e);
}

// The largest jerk over one tick of T from which velocity V can still be kept by ticks of up to L
// whose jerk is at least -J. The lower bound is the mirrored call, with v and a negated.
//
// Braking a' = (n + r) J L to zero, n ticks of -J and one that ends at a = 0 exactly, adds J L^2
// (n^2 / 2 + n r + r / 2) to the velocity, and the tick before adds (a + a') T / 2. Both together
// grow piecewise linearly with a'; at r = 0 they are J L^2 (n^2 + n T / L) / 2 more than a T / 2.
// The ticks matter: with the continuous a'^2 / 2 J the filter would hammer between +J and -J at V.
double largest_jerk(double v, double a, double V, double J, double T, double L) {
  const double spare = V - (v + 0.5 * a * T);  // what is left after a tick that ends at a = 0
  if (spare > -1e-12 * V) {
    const double c = std::max(spare, 0.0) / (J * L * L), share = T / L;
    const double n = std::floor(0.5 * (std::sqrt(share * share + 8 * c) - share));
    const double r = (c - 0.5 * n * (n + share)) / (n + 0.5 * (1 + share));
    return ((n + r) * J * L - a) / T;
  }
  // Only after a reset to a state that ticks cannot keep: let a change its sign inside the tick,
  // where the peak is v + a^2 / 2|j|; beyond even that, brake as hard as allowed.
  const double room = V - v;
  return a > 0 && 2 * room * J > a * a ? -0.5 * a * a / room : -J;
}

// Where a tick is long against the limits, only this much jerk can be undone within one tick.
double usable_jerk(const DofLimits& limits, double T) {
  return std::min({limits.jerk, limits.acceleration / T, 2 * limits.velocity / (T * T)});
}

}  // namespace

void StreamDelay::step(double x, double T) {
  if (!works(T)) return;
  // Y / X = 15 / (15 + 15 D s + 6 D^2 s^2 + D^3 s^3), Bessel's polynomial of third order. While x
  // stands still the equation gives every derivative of y from the three before it; the series to
  // the fourth order is exact to 1e-5 in steps of an eighth of D.
  const double D = delay_;
  const auto next = [D](double y0, double y1, double y2) {
    return -(15 * y0 + 15 * D * y1 + 6 * D * D * y2) / (D * D * D);
  };
  const int steps = static_cast<int>(std::ceil(8 * T / D));  // at most 8, as D >= T
  const double h = T / steps;
  for (int i = 0; i < steps; ++i) {
    const double y0 = state_.x - x, y1 = state_.v, y2 = state_.a;
    const double y3 = next(y0, y1, y2), y4 = next(y1, y2, y3);
    const double y5 = next(y2, y3, y4), y6 = next(y3, y4, y5);
    state_.x += h * (y1 + h / 2 * (y2 + h / 3 * (y3 + h / 4 * y4)));
    state_.v += h * (y2 + h / 2 * (y3 + h / 3 * (y4 + h / 4 * y5)));
    state_.a += h * (y3 + h / 2 * (y4 + h / 3 * (y5 + h / 4 * y6)));
  }
}

Kinematic StreamDelay::predict(double ahead) const {
  return {state_.x + ahead * (state_.v + 0.5 * ahead * state_.a), state_.v + ahead * state_.a,
          state_.a};
}

void StreamFilter::step(const Kinematic& target, double T, double period, const Kinematic* ahead) {
  if (!(T > 0) || !(limits_.velocity > 0)) return;
  const double V = limits_.velocity, A = limits_.acceleration, J = limits_.jerk;
  const Kinematic& own = state_;

  const double x1 = own.x + T * (own.v + 0.5 * T * own.a);
  const double v1 = own.v + T * own.a;
  // A target that is not finite means: come to rest.
  const bool known = std::isfinite(target.x) && std::isfinite(target.v);
  const double slower = std::min(1.0, kFastestGain / (kVelocityGain * std::max(T, period)));
  const auto speed_to = [&](const Kinematic& to) {
    return to.v + approach(to.x - x1, slower * kPositionGain, kStreamAccelerationShare * A);
  };
  double wish = known ? speed_to(target) : 0.0;
  if (known && ahead) {
    const double soon = speed_to(*ahead);
    wish = wish * soon > 0 ? std::copysign(std::min(std::abs(wish), std::abs(soon)), wish) : 0.0;
  }
  const double vc = clamp_to(wish, V);
  double fed = 0;
  if (known && std::isfinite(target.a)) {
    fed = clamp_to(kFedForward * target.a, std::min(A, kJerkTime * J));
  }
  const double ac = clamp_to(fed + approach(vc - v1, slower * kVelocityGain, kJerkShare * J), A);
  const double gain = slower * kAccelerationGain;
  double j = gain * (ac - own.a) / (1 + 0.5 * gain * T);

  const double longest = std::max(T, kLongestTick), usable = usable_jerk(limits_, longest);
  j = std::min(j, largest_jerk(own.v, own.a, V, usable, T, longest));
  j = std::max(j, -largest_jerk(-own.v, -own.a, V, usable, T, longest));
  integrate(j, T);
}

void StreamFilter::brake(double T) {
  if (!(T > 0) || !(limits_.velocity > 0)) return;
  const double v = state_.v, a = state_.a, J = usable_jerk(limits_, T);
  // Two ticks that end at rest exactly, the second one perhaps idle.
  double j = -(v + 1.5 * a * T) / (T * T);
  const double next = (v + 0.5 * a * T) / (T * T);
  if (std::max(std::abs(j), std::abs(next)) > J || std::abs(a + j * T) > limits_.acceleration) {
    // As hard as leaves a way to rest without crossing zero: the velocity limit 0, seen from the
    // side on which the velocity lies once a is gone. While it is still on its way there: full
    // jerk.
    const double side = std::copysign(1.0, v + 0.5 * a * std::abs(a) / J);
    j = -side * (side * v > 0 ? largest_jerk(-side * v, -side * a, 0, J, T, T) : J);
  }
  integrate(j, T);
}

/// One tick with the jerk that the limits of acceleration and jerk leave of this one.
void StreamFilter::integrate(double jerk, double T) {
  const double A = limits_.acceleration;
  Kinematic& own = state_;
  double j = std::clamp(jerk, (-A - own.a) / T, (A - own.a) / T);
  j = clamp_to(j, limits_.jerk);
  own.x += T * (own.v + T * (own.a / 2 + T * j / 6));
  own.v += T * (own.a + T * j / 2);
  own.a += T * j;
}

}  // namespace surg
