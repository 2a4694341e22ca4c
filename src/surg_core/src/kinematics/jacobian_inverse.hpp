// Inverts a Jacobian once for several displacements of the flange.
#pragma once

#include <array>

#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Inverse of one Jacobian for several displacements. 'inverse_velocity' solves for one at a time;
/// it is faster where there is only one.
class Inverse {
 public:
  /// J must outlive the inverse.
  explicit Inverse(const Jacobian& J);

  bool regular() const { return regular_; }
  const Pivots& pivots() const { return pivots_; }
  /// The smallest dq with J dq = x; zero where J is singular.
  Joints operator()(const Vector6& x) const;
  /// For redundant arms the one next to 'posture'.
  Joints operator()(const Vector6& x, const Joints& posture) const;

 private:
  const Jacobian& J_;
  Eigen::Index n_;
  Eigen::Matrix<double, 6, 6> A_;  ///< the inverse of J, or of J J^T
  Pivots pivots_;
  bool regular_ = false;
};

template <int n>
using Vectors6 = Eigen::Matrix<double, 6, n>;

/// The smallest dq with J dq = x for one or two twists x, in one elimination: faster than an
/// 'Inverse' where there are no more. Not finite, or noise, where the pivots' ratio is 0.
template <int n>
struct Steps {
  std::array<Joints, n> dq;
  Pivots pivots;
};
template <int n>
Steps<n> least_steps(const Jacobian& J, const Vectors6<n>& twists);

/// J qd, column by column: Eigen's product of dynamic size takes three times as long.
inline Vector6 flange_twist(const Jacobian& J, const Joints& qd) {
  Vector6 twist = J.col(0) * qd[0];
  for (Eigen::Index i = 1; i < J.cols(); ++i) twist += J.col(i) * qd[i];
  return twist;
}

/// From one flange pose to another as a small twist: translation, then rotation vector to the fifth
/// order of its angle (arcsin's series on the skew part). A Newton step needs the first; the third
/// keeps longer steps, up to a quarter turn, on their way.
inline Vector6 displacement(const Pose& from, const Pose& to) {
  Vector3 sine = Vector3::Zero();  // twice: the vector of R - R^T, R = to from^T
  for (int i = 0; i < 3; ++i) {
    sine += Vector3(from.linear().col(i)).cross(Vector3(to.linear().col(i)));
  }
  sine *= 0.5;
  Vector6 twist;
  twist.head<3>() = to.translation() - from.translation();
  twist.tail<3>() = (1.0 + sine.squaredNorm() / 6.0) * sine;
  return twist;
}

}  // namespace surg
