// The exact form without limits: joints for the next pose, for tests of what a law can do at best.
#pragma once

#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/types.hpp"

namespace surg::test {

/// The joints that put the flange at a pose a few milliradians away: Newton's method from q, one
/// step with 'posture' [rad], the displacement preferred in the null space, and one without.
inline JointVector next_joints(const Chain& chain, const JointVector& q, const Pose& X_goal,
                               const JointVector& posture) {
  JointVector next = q;
  for (const JointVector& wish : {posture, JointVector(JointVector::Zero(q.size()))}) {
    const auto [X_BF, J] = chain.flange(next);
    Vector6 twist;
    twist.head<3>() = X_goal.translation() - X_BF.translation();
    const Eigen::AngleAxisd turn(Matrix3(X_goal.linear() * X_BF.linear().transpose()));
    twist.tail<3>() = turn.angle() * turn.axis();
    next += inverse_velocity(J, twist, wish).qd;
  }
  return next;
}

}  // namespace surg::test
