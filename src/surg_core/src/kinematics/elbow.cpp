#include "surg_core/kinematics/elbow.hpp"

#include <cmath>
#include <limits>

#include "kinematics/jacobian_inverse.hpp"
#include "surg_core/law/rcm.hpp"

namespace surg {
namespace {

constexpr int kDof = 7;
constexpr double kSmallestSine = 0.02;  // below it a direction across a line has no meaning
constexpr double kStep = 1e-4;          // [rad] of the largest joint, for a central difference
constexpr double kLargeEnough = 0.3;    // of a unit vector's component; one of seven is above 0.37

}  // namespace

double swivel_angle(const Chain& chain, const JointVector& q) {
  constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
  if (chain.dof() != kDof || q.size() != kDof) return kUnknown;
  Vector3 origin[kDof];
  Pose X = Pose::Identity();
  for (int i = 0; i < kDof - 1; ++i) {
    const Joint& joint = chain.joints()[i];
    X = X * joint.X_PJ;
    origin[i] = X.translation();
    X.linear() = X.linear() * Eigen::AngleAxisd(q[i], joint.axis).toRotationMatrix();
  }
  const Vector3& shoulder = origin[1];
  const Vector3 to_wrist = origin[5] - shoulder, to_elbow = origin[3] - shoulder;
  const double reach = to_wrist.norm();
  if (!(reach > kSmallestSine * to_elbow.norm())) return kUnknown;
  const Vector3 line = to_wrist / reach;
  const Joint& first = chain.joints()[0];
  const Vector3 up = first.X_PJ.linear() * first.axis;
  const Vector3 zero = up - line * line.dot(up);
  const Vector3 elbow = to_elbow - line * line.dot(to_elbow);
  const bool clear = zero.norm() > kSmallestSine && elbow.norm() > kSmallestSine * to_elbow.norm();
  return clear ? std::atan2(line.dot(zero.cross(elbow)), zero.dot(elbow)) : kUnknown;
}

ElbowTurn elbow_turn(const Chain& chain, const JointVector& q, const Jacobian& J) {
  ElbowTurn turn;
  turn.angle = swivel_angle(chain, q);
  turn.per_angle = JointVector::Zero(q.size());
  const Inverse inverse(J);
  if (!std::isfinite(turn.angle) || !inverse.regular()) return turn;
  // The null space has one dimension: a unit vector's projection into it is that joint's component
  // times the unit null vector.
  JointVector null = JointVector::Zero(q.size());
  for (Eigen::Index i = 0; i < q.size() && !(null.norm() > kLargeEnough); ++i) {
    const JointVector projected = inverse(Vector6::Zero(), Joints(Joints::Unit(i))).head(q.size());
    if (projected.norm() > null.norm()) null = projected;
  }
  null /= null.norm();
  const double turned = wrapped(swivel_angle(chain, JointVector(q + kStep * null)) -
                                swivel_angle(chain, JointVector(q - kStep * null))) /
                        (2 * kStep);
  if (!(std::abs(turned) > ElbowTurn::kLeast)) return turn;
  turn.per_angle = null / turned;
  turn.regular = true;
  return turn;
}

}  // namespace surg
