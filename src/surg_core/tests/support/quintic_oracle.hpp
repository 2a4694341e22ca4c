// A second opinion on quintics that end at rest: coefficients in plain time instead of normalised
// time, long double, roots of jerk by formula, all other extremes by bisection between them.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "surg_core/motion/quintic.hpp"

namespace surg::test {

/// Greatest |v|, |a| and |jerk|.
struct Extremes {
  double velocity = 0, acceleration = 0, jerk = 0;
};

class QuinticOracle {
 public:
  /// From a state to rest at 'target' in d > 0 seconds.
  QuinticOracle(const Kinematic& from, double target, double d) : d_(d) {
    const Real D = Real(target) - from.x, v = from.v, a = from.a, t = d;
    c_[0] = from.x;
    c_[1] = v;
    c_[2] = a / 2;
    c_[3] = (20 * D - 12 * v * t - 3 * a * t * t) / (2 * t * t * t);
    c_[4] = (-30 * D + 16 * v * t + 3 * a * t * t) / (2 * t * t * t * t);
    c_[5] = (12 * D - 6 * v * t - a * t * t) / (2 * t * t * t * t * t);
  }

  Extremes extremes() const {
    Extremes out;
    const std::vector<Real> vertex = with_ends({-c_[4] / (5 * c_[5])});
    const std::vector<Real> jerk_zero = with_ends(jerk_roots());
    const std::vector<Real> a_zero = crossings(2, jerk_zero);
    for (const Real t : vertex) out.jerk = std::max(out.jerk, magnitude(3, t));
    for (const Real t : jerk_zero) out.acceleration = std::max(out.acceleration, magnitude(2, t));
    for (const Real t : a_zero) out.velocity = std::max(out.velocity, magnitude(1, t));
    return out;
  }

  double x(double t) const { return static_cast<double>(value(0, t)); }
  double v(double t) const { return static_cast<double>(value(1, t)); }
  double a(double t) const { return static_cast<double>(value(2, t)); }

 private:
  using Real = long double;

  /// The derivative of this order.
  Real value(int order, Real t) const {
    Real sum = 0, power = 1;
    for (int i = order; i <= 5; ++i, power *= t) {
      Real factor = 1;
      for (int k = 0; k < order; ++k) factor *= i - k;
      sum += factor * c_[i] * power;
    }
    return sum;
  }
  double magnitude(int order, Real t) const {
    return static_cast<double>(std::abs(value(order, t)));
  }

  /// 6 c3 + 24 c4 t + 60 c5 t^2 = 0.
  std::vector<Real> jerk_roots() const {
    const Real a = 10 * c_[5], b = 4 * c_[4], c = c_[3], root = b * b - 4 * a * c;
    if (root < 0) return {};
    const Real q = -(b + std::copysign(std::sqrt(root), b)) / 2;
    return {q / a, c / q};
  }
  std::vector<Real> with_ends(const std::vector<Real>& times) const {
    std::vector<Real> out = {0, d_};
    for (const Real t : times) {
      if (t > 0 && t < d_) out.push_back(t);
    }
    std::sort(out.begin(), out.end());
    return out;
  }
  /// Both ends, and the sign changes of this derivative between borders where it is monotone.
  std::vector<Real> crossings(int order, const std::vector<Real>& borders) const {
    std::vector<Real> out;
    for (std::size_t i = 0; i + 1 < borders.size(); ++i) {
      Real low = borders[i], high = borders[i + 1];
      const bool rising = value(order, low) < 0;
      if (rising == (value(order, high) < 0)) continue;
      for (int k = 0; k < 70; ++k) {
        const Real middle = (low + high) / 2;
        ((value(order, middle) < 0) == rising ? low : high) = middle;
      }
      out.push_back((low + high) / 2);
    }
    return with_ends(out);
  }

  Real c_[6];
  Real d_;
};

}  // namespace surg::test
