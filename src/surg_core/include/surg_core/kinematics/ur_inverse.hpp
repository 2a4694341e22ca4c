// Closed-form inverse kinematics of arms of the Universal Robots family: a shoulder of two crossing
// axes, two links between three parallel axes, a wrist of right angles without a common centre. The
// geometry is derived from the chain, whatever frames its description uses. Eight branches.
#pragma once

#include <array>
#include <optional>
#include <string>

#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// One of eight postures: the signs of the three measures that vanish at a singularity.
struct UrBranch {
  bool shoulder = true;  ///< wrist centre before the base axis (in the direction of the links)
  bool elbow = true;     ///< sine of the elbow positive
  bool wrist = true;     ///< sine of wrist 2 positive
};

/// One solution and its distance to the singularities: 0 there, signed by the branch.
struct UrSolution {
  JointVector q;
  /// Why the branch does not reach the pose: "shoulder" (the wrist centre is closer to the base
  /// axis than the arm is wide), "elbow" (too far or too near), "wrist" (exactly singular);
  /// nullptr: reached.
  const char* unreachable = nullptr;
  double shoulder = 0;  ///< [m] reach of the wrist centre from the base axis, in the links' plane
  double elbow = 0;     ///< sine of the elbow
  double wrist = 0;     ///< sine of wrist 2
};

/// The eight branches of one pose, 'count' of them reached.
struct UrSolutions {
  std::array<UrSolution, 8> all;
  int count = 0;
};

class UrInverse {
 public:
  /// Returns the closed form for a chain, or nothing with the reason in '*why'. A calibrated UR,
  /// whose axes are not exactly parallel, is refused too (tolerance 1e-9 rad, 1e-9 m).
  static std::optional<UrInverse> of(const Chain& chain, std::string* why = nullptr);

  UrBranch branch(const JointVector& q) const;
  /// Joints that put the flange at X_BF on one branch, each within half a turn of 'near'.
  UrSolution solve(const Pose& X_BF, const UrBranch& branch, const JointVector& near) const;
  /// Every branch that reaches the pose, first in the array.
  UrSolutions solve_all(const Pose& X_BF, const JointVector& near) const;

 private:
  UrInverse() = default;

  // Frame K: origin where axes 1 and 2 cross, z along axis 1, y along axis 2 at q = 0. Vectors in
  // the plane of the links are complex numbers z + i x, so that a turn about y is a factor.
  Pose X_KB_ = Pose::Identity();
  double width_ = 0;                    ///< [m] from the base axis to the plane of the wrist centre
  double upper_ = 0, fore_ = 0;         ///< [m] lengths of the two links in their plane
  double d5_ = 0;                       ///< [m] from axis 4 along axis 5 to axis 6
  double phase2_ = 0, phase3_ = 0;      ///< angles of the links at q = 0
  double phase_a5_ = 0, phase5_ = 0;    ///< of axis 5 in that plane, of axis 6 about axis 5
  double sign3_ = 1, sign4_ = 1;        ///< axes 3 and 4 along +y or -y
  Vector3 p_FWrist_ = Vector3::Zero();  ///< where axes 5 and 6 cross
  Vector3 a6_F_ = Vector3::UnitZ(), a5_F_ = Vector3::UnitX(), b_F_ = Vector3::UnitY();
};

}  // namespace surg
