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
  /// dq with J dq = x, for redundant arms the one next to 'posture'; zero where J is singular.
  JointVector operator()(const Vector6& x, const JointVector& posture) const;

 private:
  const Jacobian& J_;
  Eigen::Index n_;
  Eigen::Matrix<double, 6, 6> A_;  ///< the inverse of J, or of J J^T; its rows and columns permuted
  std::array<int, 6> row_{};       ///< of the pivot in each column
  bool regular_ = false;
};

/// J qd, column by column: Eigen's product of dynamic size takes three times as long.
inline Vector6 flange_twist(const Jacobian& J, const JointVector& qd) {
  Vector6 twist = J.col(0) * qd[0];
  for (Eigen::Index i = 1; i < J.cols(); ++i) twist += J.col(i) * qd[i];
  return twist;
}

/// From one flange pose to another as a small twist: translation, then rotation vector to the fifth
/// order of its angle (arcsin's series on the skew part). A Newton step needs the first; the third
/// keeps longer steps, up to a quarter turn, on their way.
Vector6 displacement(const Pose& from, const Pose& to);

}  // namespace surg
