// One-sided barrier against singularities: limits the speed of approach by the distance. Motion
// away from a singularity is never limited.
#pragma once

#include <array>

#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Signed, dimensionless distances from the singular configurations; 0 where singular. A change of
/// sign means that the arm passed through a singularity.
struct SingularityMeasures {
  int n = 0;
  std::array<double, 3> phi{};
};

/// Measures of one chain. An arm built like a Universal Robots one (joints 2 to 4 parallel, 5 and 6
/// crossing) has three: sine of the angle between shoulder and wrist centre, sine of the elbow,
/// sine of the wrist. Any other arm has one: the smallest over the largest pivot of its Jacobian.
class Barrier {
 public:
  Barrier() = default;
  explicit Barrier(const Chain& chain);

  bool like_ur() const { return like_ur_; }
  /// X_BF and J as Chain::forward gives them.
  SingularityMeasures measures(const Pose& X_BF, const Jacobian& J) const;
  /// The same where J has been eliminated already.
  SingularityMeasures measures(const Pose& X_BF, const Jacobian& J, const Pivots& pivots) const;
  /// Smallest allowed |phi| of every measure.
  double phi_min() const { return phi_min_; }
  /// Fastest approach |dphi/dt| [1/s] at |phi|: sqrt(2 a (|phi| - phi_min)).
  double fastest_approach(double phi) const;

 private:
  bool like_ur_ = false;
  Vector3 p_FWrist_ = Vector3::Zero();  ///< where axes 5 and 6 cross, in F
  double d4_ = 0;                       ///< [m] wrist centre off the arm's plane
  double a2_a3_ = 1;                    ///< [m^2] product of the upper and the lower arm
  double phi_min_ = 5e-4;
  double acceleration_ = 5;  ///< [1/s^2] of phi
};

}  // namespace surg
