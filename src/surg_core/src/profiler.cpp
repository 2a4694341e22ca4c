#include "surg_core/profiler.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace surg {
namespace {

// The exact check decides, up to rounding.
constexpr double kRounding = 1 + 1e-12;
constexpr double kScanStep = 1.04;    // the set of feasible durations is not one interval
constexpr double kResolution = 1e-4;  // of the duration [s]

// How far a quintic is beyond its limits: largest ratio of an extreme to its limit. Cheapest test
// first; 'enough' stops the search for candidates that lost already.
double excess(const Quintic& q, const DofLimits& limits, double enough) {
  double worst = q.max_jerk() / limits.jerk;
  if (worst > enough) return worst;
  worst = std::max(worst, q.max_acceleration() / limits.acceleration);
  if (worst > enough) return worst;
  return std::max(worst, q.max_velocity() / limits.velocity);
}

// A duration that is always long enough from a = 0 and |v| <= V. The quintic is the sum of a part
// for the distance D and a part for v; each may take half of the acceleration and of the jerk:
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

// Rest to rest, the least duration is known in closed form.
double rest_to_rest(double D, const DofLimits& limits) {
  return std::max({15 * D / (8 * limits.velocity),
                   std::sqrt(10 * D / (std::sqrt(3.0) * limits.acceleration)),
                   std::cbrt(60 * D / limits.jerk)});
}

Kinematic with_jerk(const Kinematic& from, double jerk, double t) {
  return {from.x + t * (from.v + t * (from.a / 2 + t * jerk / 6)),
          from.v + t * (from.a + t * jerk / 2), from.a + t * jerk};
}

}  // namespace

Profiler::Profiler(const std::array<DofLimits, kDof>& limits, double base_duration)
    : limits_(limits), base_duration_(base_duration) {
  for (const DofLimits& limit : limits) {
    if (!(limit.velocity > 0 && limit.acceleration > 0 && limit.jerk > 0)) {
      throw std::invalid_argument("profiler: velocity, acceleration and jerk limits must be > 0");
    }
  }
  if (!(base_duration > 0)) throw std::invalid_argument("profiler: the base duration must be > 0");
}

void Profiler::reset(const std::array<double, kDof>& x) {
  std::array<Kinematic, kDof> state;
  for (int i = 0; i < kDof; ++i) state[i] = {x[i], 0, 0};
  reset(state);
}

void Profiler::reset(const std::array<Kinematic, kDof>& state) {
  state_ = state;
  t_ = 0;
  brake_duration_ = 0;
  for (int i = 0; i < kDof; ++i) q_[i] = Quintic(state[i], state[i], 0);
}

Profiler::Plan Profiler::build(const std::array<Kinematic, kDof>& from,
                               const std::array<double, kDof>& target, double duration,
                               double enough) const {
  Plan plan;
  for (int i = 0; i < kDof && plan.excess <= enough; ++i) {
    plan.q[i] = Quintic(from[i], {target[i], 0, 0}, duration);
    plan.excess = std::max(plan.excess, excess(plan.q[i], limits_[i], enough));
  }
  return plan;
}

Profiler::Plan Profiler::search(const std::array<Kinematic, kDof>& from,
                                const std::array<double, kDof>& target) const {
  double first = base_duration_, at_rest = base_duration_, longest = base_duration_;
  bool resting = true;
  for (int i = 0; i < kDof; ++i) {
    const double D = std::abs(target[i] - from[i].x);
    first = std::max(first, D / limits_[i].velocity);  // nothing arrives sooner
    at_rest = std::max(at_rest, rest_to_rest(D, limits_[i]));
    longest = std::max(longest, surely_enough(from[i], target[i], limits_[i]));
    resting = resting && from[i].v == 0 && from[i].a == 0;
  }
  if (resting) return build(from, target, at_rest, kRounding);

  // Scan upwards for the first duration that holds, then bisect between it and its failing
  // neighbour. Every candidate is judged by the exact extremes.
  double failed = 0, d = first;
  Plan plan = build(from, target, d, kRounding);
  while (plan.excess > kRounding && d < longest) {
    failed = d;
    d = std::min(d * kScanStep, longest);
    plan = build(from, target, d, kRounding);
  }
  if (plan.excess > kRounding || failed == 0) return plan;
  while (d - failed > kResolution) {
    const double middle = 0.5 * (failed + d);
    const Plan candidate = build(from, target, middle, kRounding);
    if (candidate.excess <= kRounding) {
      d = middle;
      plan = candidate;
    } else {
      failed = middle;
    }
  }
  return plan;
}

Profiler::Plan Profiler::least_excess(const std::array<Kinematic, kDof>& from,
                                      const std::array<double, kDof>& target) const {
  double longest = base_duration_;
  for (int i = 0; i < kDof; ++i) {
    longest = std::max(longest, surely_enough(from[i], target[i], limits_[i]));
  }
  Plan best = build(from, target, longest, std::numeric_limits<double>::infinity());
  for (double d = base_duration_; d < longest; d *= kScanStep) {
    const Plan candidate = build(from, target, d, best.excess);
    if (candidate.excess < best.excess) best = candidate;
  }
  return best;
}

void Profiler::plan(const std::array<double, kDof>& target) {
  for (double x : target) {
    if (!std::isfinite(x)) return;
  }
  const std::array<Kinematic, kDof> from = state_;
  t_ = 0;
  brake_duration_ = 0;
  Plan plan = search(from, target);
  if (plan.excess > kRounding) {
    // No single quintic keeps the limits (surely so when |a0| exceeds its limit). Bring every a to
    // zero first, with full jerk; from there a long enough quintic always exists, unless |v| is
    // beyond its limit too. Then nothing can hold, and the duration that exceeds the limits least
    // is taken.
    double brake = 0;
    for (int i = 0; i < kDof; ++i) brake = std::max(brake, std::abs(from[i].a) / limits_[i].jerk);
    brake_from_ = from;
    std::array<Kinematic, kDof> braked;
    for (int i = 0; i < kDof; ++i) braked[i] = braking(i, brake);
    plan = search(braked, target);
    if (plan.excess > kRounding) plan = least_excess(braked, target);
    brake_duration_ = brake;
  }
  q_ = plan.q;
}

void Profiler::plan_fixed(const std::array<double, kDof>& target, double duration) {
  const std::array<Kinematic, kDof> from = state_;
  t_ = 0;
  brake_duration_ = 0;
  for (int i = 0; i < kDof; ++i) q_[i] = Quintic(from[i], {target[i], 0, 0}, duration);
}

Kinematic Profiler::braking(int dof, double t) const {
  const Kinematic& from = brake_from_[dof];
  const double ramp = std::abs(from.a) / limits_[dof].jerk;
  Kinematic now = with_jerk(from, -std::copysign(limits_[dof].jerk, from.a), std::min(t, ramp));
  if (t >= ramp) {  // then at constant velocity until the slowest degree of freedom has finished
    now.a = 0;
    now.x += now.v * (t - ramp);
  }
  return now;
}

void Profiler::advance(double dt) {
  t_ = std::min(t_ + dt, duration());
  for (int i = 0; i < kDof; ++i) {
    if (t_ < brake_duration_) {
      state_[i] = braking(i, t_);
    } else {
      // At the end exactly the target: t_ - brake_duration_ may be a rounding short of it.
      state_[i] = q_[i].at(done() ? q_[i].duration() : t_ - brake_duration_);
    }
  }
}

bool Profiler::done() const { return t_ >= duration(); }

double Profiler::duration() const { return brake_duration_ + q_[0].duration(); }

}  // namespace surg
