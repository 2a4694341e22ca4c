// Inverts a Jacobian once for several displacements of the flange.
#pragma once

#include <array>

#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Inverse of one Jacobian for several displacements. 'inverse_velocity' solves for one at a time;
/// used in the look-ahead it would take a third of its cost.
class Inverse {
 public:
  /// J must outlive the inverse.
  explicit Inverse(const Jacobian& J);

  bool regular() const { return regular_; }
  /// dq with J dq = x, for redundant arms the one next to 'posture'; zero where J is singular.
  JointVector operator()(const Vector6& x, const JointVector& posture) const;
  /// The same for two at a time, which costs no more than one.
  std::array<JointVector, 2> both(const Vector6& x, const Vector6& y,
                                  const JointVector& posture) const;

 private:
  using Pair = Eigen::Matrix<double, 6, 2, Eigen::RowMajor>;
  void substitute(Pair& x) const;

  const Jacobian& J_;
  Eigen::Index n_;
  Eigen::Matrix<double, 6, 6> A_;  ///< factors L and U of J, or of J J^T, with rows swapped
  std::array<int, 6> swap_{};
  bool regular_ = false;
};

/// From one flange pose to another as a small twist: translation, then rotation vector to the fifth
/// order of its angle.
Vector6 displacement(const Pose& from, const Pose& to);

}  // namespace surg
