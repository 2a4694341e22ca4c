// A second opinion on the hardest stop: small steps of a feedback law that knows no duration and no
// switching time.
#pragma once

#include <algorithm>
#include <cmath>

#include "surg_core/motion/quintic.hpp"

namespace surg::test {

/// Its distance, in steps of h seconds. The deepest acceleration allowed is the one from which full
/// jerk still returns to zero before the velocity does.
inline double stop_by_feedback(const Kinematic& from, const DofLimits& limits, double h) {
  const double A = limits.acceleration, J = limits.jerk;
  const double side = from.v + 0.5 * from.a * std::abs(from.a) / J > 0 ? 1 : -1;
  double x = 0, v = side * from.v, a = side * from.a;
  while (v > 0 || v + 0.5 * a * std::abs(a) / J > 0.5 * J * h * h) {
    const double wish = -std::min(A, std::sqrt(2 * J * std::max(v, 0.0)));
    const double next = a + std::clamp(wish - a, -J * h, J * h);
    const double v_next = v + 0.5 * (a + next) * h;
    x += 0.5 * (v + v_next) * h;
    v = v_next;
    a = next;
  }
  return side * x;
}

}  // namespace surg::test
