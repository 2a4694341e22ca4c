// The elbow of a seven-joint arm: its swivel angle, and the joint motion that turns it while the
// flange stays. docs/reference/conventions.md defines the angle.
#pragma once

#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Swivel angle [rad] in (-pi, pi]: of the elbow about the line from shoulder to wrist, 0 where the
/// elbow is on the side to which the first axis points. Shoulder, elbow and wrist are the origins
/// of joints 2, 4 and 6. NaN for another number of joints than seven, a straight arm, or a wrist on
/// the first axis.
double swivel_angle(const Chain& chain, const JointVector& q);

/// How the joints turn the elbow at one posture.
struct ElbowTurn {
  static constexpr double kLeast = 0.1;  ///< [rad/rad] per joint motion; with less it is stuck
  double angle = 0;                      ///< [rad] swivel angle
  JointVector per_angle;  ///< joint motion per swivel angle with the flange at rest [rad/rad]
  bool regular = false;   ///< false: the angle is undefined, or no joint motion turns the elbow
};
/// J: of the chain at q.
ElbowTurn elbow_turn(const Chain& chain, const JointVector& q, const Jacobian& J);

}  // namespace surg
