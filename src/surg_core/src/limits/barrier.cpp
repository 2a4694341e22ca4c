#include "surg_core/limits/barrier.hpp"

#include <algorithm>
#include <cmath>

#include "kinematics/jacobian_inverse.hpp"

namespace surg {
namespace {

constexpr double kParallel = 1e-9;

Vector3 axis(const Jacobian& J, int i) { return J.col(i).tail<3>(); }
/// Velocity of the flange origin by joint i: axis x (flange - joint).
Vector3 moment(const Jacobian& J, int i) { return J.col(i).head<3>(); }

}  // namespace

Barrier::Barrier(const Chain& chain) {
  if (chain.dof() != 6) return;
  // A configuration in which no two of the axes meet by chance.
  JointVector q(6);
  q << 0.3, -1.1, 1.3, -0.7, 1.2, 0.4;
  const Chain::Flange flange = chain.flange(q);
  const Jacobian& J = flange.J;
  const Vector3 z1 = axis(J, 0), z2 = axis(J, 1), z5 = axis(J, 4), z6 = axis(J, 5);
  const bool parallel = z2.cross(axis(J, 2)).norm() < kParallel &&
                        z2.cross(axis(J, 3)).norm() < kParallel &&
                        (axis(J, 2) - z2).norm() < kParallel;
  const bool square = std::abs(z1.dot(z2)) < kParallel &&
                      std::abs(axis(J, 3).dot(z5)) < kParallel && std::abs(z5.dot(z6)) < kParallel;
  // Point of an axis that is nearest to the flange origin, relative to it.
  const auto nearest = [&](int i) { return Vector3(-moment(J, i).cross(axis(J, i))); };
  const Vector3 r5 = -nearest(4), r6 = -nearest(5);
  // Axes 5 and 6 cross where the distance of the two lines is 0.
  const Vector3 common = z5.cross(z6);
  const bool crossing = common.norm() > 0.1 && std::abs(common.dot(r5 - r6)) < kParallel;
  // Axes 1 and 2 cross as well: otherwise the shoulder's measure below has another zero.
  const Vector3 between = nearest(0) - nearest(1);
  const bool shoulder = std::abs(z1.cross(z2).dot(between)) < kParallel;
  if (!parallel || !square || !crossing || !shoulder) return;
  like_ur_ = true;
  // p = nearest6 + t z6 on axis 6 that lies on axis 5: (p - nearest5) is parallel to z5.
  const Vector3 gap = nearest(4) - nearest(5);
  const double t = gap.dot(z6);  // z5 is square to z6
  const Vector3 wrist = nearest(5) + t * z6;
  p_FWrist_ = flange.X_BF.linear().transpose() * wrist;
  d4_ = std::abs((wrist - nearest(0)).dot(z2));
  const Vector3 upper = moment(J, 1) - moment(J, 2), lower = moment(J, 2) - moment(J, 3);
  a2_a3_ = upper.norm() * lower.norm();
}

SingularityMeasures Barrier::measures(const Pose& X_BF, const Jacobian& J) const {
  return measures(X_BF, J, like_ur_ || J.cols() < 6 ? Pivots() : Inverse(J).pivots());
}

SingularityMeasures Barrier::measures(const Pose& X_BF, const Jacobian& J,
                                      const Pivots& pivots) const {
  SingularityMeasures m;
  if (!like_ur_) {
    m.n = 1;
    m.phi[0] = pivots.signed_ratio();
    return m;
  }
  m.n = 3;
  const Vector3 z1 = axis(J, 0), z2 = axis(J, 1);
  // Wrist centre off the plane through axes 1 and 2: its velocity by joint 1 alone, along axis 2.
  const Vector3 by_1 = moment(J, 0) + z1.cross(Vector3(X_BF.linear() * p_FWrist_));
  const double reach = by_1.dot(z2);
  m.phi[0] = reach / std::max(std::sqrt(reach * reach + d4_ * d4_), 1e-12);
  const Vector3 upper = moment(J, 1) - moment(J, 2), lower = moment(J, 2) - moment(J, 3);
  m.phi[1] = upper.cross(lower).dot(z2) / a2_a3_;
  m.phi[2] = axis(J, 3).cross(axis(J, 5)).dot(axis(J, 4));
  return m;
}

double Barrier::fastest_approach(double phi) const {
  return std::sqrt(2 * acceleration_ * std::max(std::abs(phi) - phi_min_, 0.0));
}

}  // namespace surg
