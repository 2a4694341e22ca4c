#include "surg_core/motion/profiler.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kRounding = 1 + 1e-12;  // of a limit
constexpr double kScanStep = 1.04;  // from one tried duration to the next; feasible ones have gaps
constexpr double kResolution = 1e-4;  // of the duration [s]

// The exact check that decides; cheapest part first.
bool within_limits(const Quintic& q, const DofLimits& limits) {
  return q.max_jerk() <= limits.jerk * kRounding &&
         q.max_acceleration() <= limits.acceleration * kRounding &&
         q.max_velocity() <= limits.velocity * kRounding;
}

// A duration that is always long enough from a = 0 and |v| <= V. The quintic is the
// sum of a part for the distance D and a part for v; each may take half of the acceleration and of
// the jerk:
//   distance part: peaks 10 D / (sqrt(3) d^2) and 60 D / d^3;
//   v part: peaks 3.94 v / d and 36 v / d^2.
// With d >= 4 D / V the two velocity parts stay within V together.
double surely_enough(const Kinematic& from, double target, const DofLimits& limits) {
  const double D = std::abs(target - from.x), v = std::abs(from.v);
  return std::max({4 * D / limits.velocity,
                   std::sqrt(20 * D / (std::sqrt(3.0) * limits.acceleration)),
                   8 * v / limits.acceleration, std::cbrt(120 * D / limits.jerk),
                   std::sqrt(72 * v / limits.jerk)});
}

// Rest to rest, the least duration is known in closed form, and the path is monotone.
double rest_to_rest(double D, const DofLimits& limits) {
  return std::max({15 * D / (8 * limits.velocity),
                   std::sqrt(10 * D / (std::sqrt(3.0) * limits.acceleration)),
                   std::cbrt(60 * D / limits.jerk)});
}

// Whether a state is inside its limits and can stay there: full jerk brings a to zero before v is
// beyond its own.
bool can_keep(const Kinematic& state, const DofLimits& limits) {
  const double eased = state.v + 0.5 * state.a * std::abs(state.a) / limits.jerk;
  return std::abs(state.a) <= limits.acceleration * kRounding &&
         std::max(std::abs(state.v), std::abs(eased)) <= limits.velocity * kRounding;
}

}  // namespace

Profiler::Profiler(const std::array<DofLimits, kDof>& limits, double base_duration)
    : limits_(limits), base_duration_(base_duration) {}

void Profiler::reset(const std::array<Kinematic, kDof>& state) {
  state_ = state;
  t_ = 0;
  brake_duration_ = 0;
  for (int i = 0; i < kDof; ++i) q_[i] = Quintic(state[i], state[i], 0);
}

/// Whether the quintics of this duration keep the limits.
bool Profiler::build(const std::array<Kinematic, kDof>& from,
                     const std::array<double, kDof>& target, double duration, Quintics& q) const {
  for (int i = 0; i < kDof; ++i) {
    q[i] = Quintic(from[i], {target[i], 0, 0}, duration);
    if (!within_limits(q[i], limits_[i])) return false;
  }
  return true;
}

/// The quintics of the first duration that holds, found by scanning upwards and then bisecting
/// between it and its failing neighbour. False: there is none.
bool Profiler::search(const std::array<Kinematic, kDof>& from,
                      const std::array<double, kDof>& target, Quintics& q) const {
  double first = base_duration_, at_rest = base_duration_, longest = base_duration_;
  bool resting = true;
  for (int i = 0; i < kDof; ++i) {
    const double D = std::abs(target[i] - from[i].x);
    first = std::max(first, D / limits_[i].velocity);  // nothing arrives sooner
    at_rest = std::max(at_rest, rest_to_rest(D, limits_[i]));
    longest = std::max(longest, surely_enough(from[i], target[i], limits_[i]));
    resting = resting && from[i].v == 0 && from[i].a == 0;
  }
  if (resting) {
    for (int i = 0; i < kDof; ++i) q[i] = Quintic(from[i], {target[i], 0, 0}, at_rest);
    return true;
  }
  double failed = 0, d = first;
  while (!build(from, target, d, q)) {
    if (!(d < longest)) return false;
    failed = d;
    d = std::min(d * kScanStep, longest);
  }
  while (failed > 0 && d - failed > kResolution) {
    const double middle = 0.5 * (failed + d);
    Quintics candidate;
    if (build(from, target, middle, candidate)) {
      d = middle;
      q = candidate;
    } else {
      failed = middle;
    }
  }
  return true;
}

bool Profiler::plan(const std::array<double, kDof>& target) {
  for (double x : target) {
    if (!std::isfinite(x)) return false;
  }
  const std::array<Kinematic, kDof> from = state_;
  t_ = 0;
  brake_duration_ = 0;
  if (search(from, target, q_)) return true;
  bool keepable = true;
  for (int i = 0; i < kDof; ++i) keepable = keepable && can_keep(from[i], limits_[i]);
  if (brake_first(&Braking::ease, from, target)) return keepable;
  return brake_first(&Braking::stop, from, target) && keepable;
}

/// Brakes every degree of freedom, then goes to the target. False: no quintic holds after it. (From
/// rest there is always one.)
bool Profiler::brake_first(Brake brake, const std::array<Kinematic, kDof>& from,
                           const std::array<double, kDof>& target) {
  brake_duration_ = 0;
  for (int i = 0; i < kDof; ++i) {
    brake_[i] = brake(from[i], limits_[i]);
    brake_duration_ = std::max(brake_duration_, brake_[i].duration());
  }
  std::array<Kinematic, kDof> after;
  for (int i = 0; i < kDof; ++i) after[i] = brake_[i].at(brake_duration_);
  return search(after, target, q_);
}

void Profiler::plan_fixed(const std::array<double, kDof>& target, double duration) {
  const std::array<Kinematic, kDof> from = state_;
  t_ = 0;
  brake_duration_ = 0;
  for (int i = 0; i < kDof; ++i) q_[i] = Quintic(from[i], {target[i], 0, 0}, duration);
}

void Profiler::advance(double dt) {
  t_ = std::min(t_ + dt, duration());
  for (int i = 0; i < kDof; ++i) {
    if (t_ < brake_duration_) {
      state_[i] = brake_[i].at(t_);
    } else {
      // At the end exactly the target: t_ - brake_duration_ may be a rounding short of it.
      state_[i] = q_[i].at(done() ? q_[i].duration() : t_ - brake_duration_);
    }
  }
}

std::array<double, Profiler::kDof> Profiler::position_after(double dt) const {
  const double end = duration(), t = std::min(t_ + dt, end);
  std::array<double, kDof> x;
  for (int i = 0; i < kDof; ++i) {
    if (t < brake_duration_) {
      x[i] = brake_[i].at(t).x;
    } else {
      x[i] = q_[i].position(t >= end ? q_[i].duration() : t - brake_duration_);
    }
  }
  return x;
}

bool Profiler::done() const { return t_ >= duration(); }

double Profiler::duration() const { return brake_duration_ + q_[0].duration(); }

}  // namespace surg
