#include "surg_core/estimators/oscillator.hpp"

#include <algorithm>
#include <cmath>

namespace surg {

Eigen::Matrix2d oscillation(double stiffness, double decay, double h) {
  const double fast = std::sqrt(std::max(stiffness - decay * decay, 1e-6));
  const double faded = std::exp(-decay * h), c = faded * std::cos(fast * h),
               s = faded * std::sin(fast * h) / fast;
  Eigen::Matrix2d F;
  F << c + decay * s, s, -stiffness * s, c - decay * s;
  return F;
}

Eigen::Matrix2d oscillation_noise(const Eigen::Matrix2d& kept, double variance, double stiffness) {
  const Eigen::Matrix2d whole = Eigen::Vector2d(variance, stiffness * variance).asDiagonal();
  return whole - kept * whole * kept.transpose();
}

Eigen::Matrix3d jerk_noise(double density, double h) {
  const double q = density * h, h2 = h * h;
  Eigen::Matrix3d Q;
  Q << q * h2 * h2 / 20, q * h2 * h / 8, q * h2 / 6,  //
      q * h2 * h / 8, q * h2 / 3, q * h / 2,          //
      q * h2 / 6, q * h / 2, q;
  return Q;
}

}  // namespace surg
