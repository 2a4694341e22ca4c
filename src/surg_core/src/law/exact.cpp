#include "surg_core/law/exact.hpp"

#include <cmath>

namespace surg {
namespace {

constexpr double kNoDirection = 1e-9;  // [m] closer than this to the trocar a tip has no direction
constexpr double kSingularRows = 1e-12;

}  // namespace

Home home_of(const Pose& X_BF, const Tool& tool) {
  return {X_BF.linear() * tool.s_F, X_BF.linear()};
}

ShaftGoal tip_goal(const Vector3& p_BRcm, const Vector3& p_BTip, double roll,
                   const Vector3& otherwise) {
  const Vector3 d = p_BTip - p_BRcm;
  const double depth = d.norm();
  if (!(depth > kNoDirection)) return {p_BRcm, otherwise, 0.0, roll};
  return {p_BRcm, d / depth, depth, roll};
}

Pose pose_on_pivot(const Home& home, const Tool& tool, const ShaftGoal& goal) {
  const Matrix3 swing = minimal_rotation(home.s_B, goal.s_B);
  Pose X_BF = Pose::Identity();
  X_BF.linear() = swing * home.R_BF;
  // Roll about the shaft where it is, after the swing: the same as about s_home before it.
  if (goal.roll != 0) {
    X_BF.linear() = Eigen::AngleAxisd(goal.roll, goal.s_B).toRotationMatrix() * X_BF.linear();
  }
  X_BF.translation() = goal.p_BTip() - X_BF.linear() * tool.p_FTip;
  return X_BF;
}

RcmRows rcm_rows(const Jacobian& J, const ShaftState& shaft) {
  const Vector3 u = shaft.s.unitOrthogonal();
  const Vector3 w = shaft.s.cross(u);
  const Vector3 arm = shaft.p_BNear - shaft.p_BF;
  RcmRows rows;
  rows.J.resize(2, J.cols());
  for (Eigen::Index i = 0; i < J.cols(); ++i) {
    const Vector3 v = J.col(i).head<3>() + Vector3(J.col(i).tail<3>()).cross(arm);
    rows.J(0, i) = u.dot(v);
    rows.J(1, i) = w.dot(v);
  }
  rows.e = {u.dot(shaft.e), w.dot(shaft.e)};
  return rows;
}

JointStep rcm_correction(const RcmRows& rows) {
  const Eigen::Index n = rows.J.cols();
  // Jr Jr^T written out: 2 x 2, and no product that might take a heap-using path.
  double a = 0, b = 0, c = 0;
  for (Eigen::Index i = 0; i < n; ++i) {
    a += rows.J(0, i) * rows.J(0, i);
    b += rows.J(0, i) * rows.J(1, i);
    c += rows.J(1, i) * rows.J(1, i);
  }
  const double determinant = a * c - b * b;
  const double scale = 0.5 * (a + c);
  JointStep step;
  step.dq.setZero(n);
  // Written so that a NaN fails as well.
  if (!(determinant > kSingularRows * scale * scale)) return step;
  const double x = (c * rows.e[0] - b * rows.e[1]) / determinant;
  const double y = (a * rows.e[1] - b * rows.e[0]) / determinant;
  for (Eigen::Index i = 0; i < n; ++i) step.dq[i] = rows.J(0, i) * x + rows.J(1, i) * y;
  step.conditioning = std::sqrt(determinant) / scale;
  return step;
}

}  // namespace surg
