// Exact form of the law, for links that take joint velocities (docs/design/control_law.md).
// The next flange pose satisfies the constraint by construction; limited_step.hpp finds its joints.
#pragma once

#include "surg_core/law/rcm.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Shaft axis and flange orientation at home: the zero of roll.
struct Home {
  Vector3 s_B = Vector3::UnitZ();
  Matrix3 R_BF = Matrix3::Identity();
};
Home home_of(const Pose& X_BF, const Tool& tool);

/// Target of the instrument in the four degrees of freedom that a trocar leaves, in B. 'depth' is
/// negative outside the patient.
struct ShaftGoal {
  Vector3 p_BRcm;    ///< trocar point at the instant of the goal; it may move between goals
  Vector3 s_B;       ///< unit shaft axis, towards the tip
  double depth = 0;  ///< L [m]: the tip is p_BRcm + L s
  double roll = 0;   ///< psi [rad], absolute, from 'Home'

  Vector3 p_BTip() const { return p_BRcm + depth * s_B; }
};
/// The goal whose tip is p_BTip, deeper than the trocar. Coinciding points give no direction: s is
/// then 'otherwise', at depth 0.
ShaftGoal tip_goal(const Vector3& p_BRcm, const Vector3& p_BTip, double roll,
                   const Vector3& otherwise);

/// X_BF on the constraint by construction: R = minimal_rotation(s_home, s) exp(psi s_home) R_home,
/// and the origin from the tip. The roll cannot drift, whatever path the tip takes.
Pose pose_on_pivot(const Home& home, const Tool& tool, const ShaftGoal& goal);

/// A displacement of the joints. 'conditioning': 0 where singular, and dq is zero.
struct JointStep {
  JointVector dq;  ///< [rad]
  double conditioning = 0;
};

/// The two rows of the pivot constraint.
struct RcmRows {
  using Matrix = Eigen::Matrix<double, 2, Eigen::Dynamic, 0, 2, kMaxJoints>;
  Matrix J;           ///< lateral velocity of the shaft point at the trocar per joint velocity
  Eigen::Vector2d e;  ///< the lateral vector to the trocar in the same two directions [m]
};
/// The two directions are any orthonormal pair across the shaft.
RcmRows rcm_rows(const Jacobian& J, const ShaftState& shaft);

/// The smallest joint displacement that, to first order, puts the shaft back on the trocar:
/// Jr^T (Jr Jr^T)^-1 e. Well conditioned even where J itself is singular: only a lateral velocity
/// of the shaft that no joint can give would spoil it (then dq is zero). The tip moves along.
JointStep rcm_correction(const RcmRows& rows);

}  // namespace surg
