#include "surg_core/limits/flange_cap.hpp"

#include <algorithm>
#include <cmath>

namespace surg {

JointVector braked_together(const JointVector& qd_last, const JointVector& acceleration, double T) {
  double cycles = 1;  // until the slowest to brake is at rest
  for (Eigen::Index i = 0; i < qd_last.size(); ++i) {
    cycles = std::max(cycles, std::abs(qd_last[i]) / (acceleration[i] * T));
  }
  return (1 - 1 / cycles) * qd_last;
}

JointVector slowed_flange(const Jacobian& J, double limit, const JointVector& fast,
                          const JointVector& slow) {
  const Vector3 v_fast = (J * fast).head<3>();
  if (!(v_fast.norm() > limit)) return fast;
  // |v + x w| = limit has one root between 0 and 1.
  const Vector3 v = (J * slow).head<3>(), w = v_fast - v;
  const double a = w.squaredNorm(), b = v.dot(w), c = v.squaredNorm() - limit * limit;
  if (!(c < 0)) return slow;
  const double x = (std::sqrt(b * b - a * c) - b) / a;
  return slow + std::clamp(x, 0.0, 1.0) * (fast - slow);
}

}  // namespace surg
