#include "surg_core/law/rcm.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

/// The part of v that is perpendicular to unit s.
Vector3 lateral(const Vector3& v, const Vector3& s) { return v - s * s.dot(v); }

}  // namespace

ShaftState shaft_state(const Pose& X_BF, const Tool& tool, const Vector3& p_BRcm) {
  ShaftState shaft;
  shaft.p_BF = X_BF.translation();
  shaft.s = X_BF.linear() * tool.s_F;
  shaft.p_BTip = X_BF * tool.p_FTip;
  shaft.depth = shaft.s.dot(shaft.p_BTip - p_BRcm);
  shaft.p_BNear = shaft.p_BTip - shaft.depth * shaft.s;
  shaft.e = p_BRcm - shaft.p_BNear;
  return shaft;
}

Vector6 rcm_twist(const ShaftState& shaft, const Vector3& v_BTip, double roll_rate,
                  const Vector3& v_BRcm, double gain, double depth_floor) {
  const Vector3& s = shaft.s;
  const double depth = std::max(shaft.depth, depth_floor);
  // The shaft point at the trocar follows the trocar and closes the error at rate 'gain'; the
  // paper's law is the case v_BRcm = 0, gain = 0, which never removes an error.
  const Vector3 v_lateral = lateral(v_BRcm, s) + gain * shaft.e;
  const Vector3 s_dot = (lateral(v_BTip, s) - v_lateral) / depth;
  const Vector3 omega = s.cross(s_dot) + roll_rate * s;
  Vector6 twist;
  twist.head<3>() =
      s.dot(v_BTip) * s + v_lateral - omega.cross(Vector3(shaft.p_BNear - shaft.p_BF));
  twist.tail<3>() = omega;
  return twist;
}

Vector6 paper_cartesian_twist(const Vector3& p_ee, const Vector3& p_tip, const Vector3& p_rcm,
                              const Vector3& v_tip, double roll_rate) {
  const Vector3 r_ee = p_rcm - p_ee;                                         // (1)
  const Vector3 r_shaft = p_tip - p_rcm;                                     // (2)
  const Vector3 omega_pivot = r_shaft.cross(v_tip) / r_shaft.squaredNorm();  // (3)
  const Vector3 r_hat = r_shaft.normalized();                                // (4)
  const Vector3 omega_ee = omega_pivot + roll_rate * r_hat;                  // (4), (5)
  const Vector3 v_insertion = v_tip.dot(r_hat) * r_hat;                      // (6)
  Vector6 twist;
  twist.head<3>() = v_insertion - omega_ee.cross(r_ee);  // (7)
  twist.tail<3>() = omega_ee;
  return twist;
}

Vector6 paper_spherical_twist(const Vector3& p_ee, const Vector3& p_rcm, double pitch_rate,
                              double yaw_rate, double roll_rate, double v_trans) {
  const Vector3 r_ee = p_rcm - p_ee;  // (1)
  const Vector3 r_hat = r_ee.normalized();
  const Vector3 omega_ee = Vector3(pitch_rate, yaw_rate, 0) + roll_rate * r_hat;  // (8)
  Vector6 twist;
  twist.head<3>() = v_trans * r_hat - omega_ee.cross(r_ee);  // (9)
  twist.tail<3>() = omega_ee;
  return twist;
}

Vector3 shaft_direction(double yaw, double pitch) {
  return {std::sin(yaw) * std::cos(pitch), std::sin(pitch), std::cos(yaw) * std::cos(pitch)};
}

Eigen::Vector2d shaft_angles(const Vector3& s_R) {
  return {std::atan2(s_R.x(), s_R.z()), std::asin(std::clamp(s_R.y(), -1.0, 1.0))};
}

Vector3 shaft_direction_rate(double yaw, double pitch, double yaw_rate, double pitch_rate) {
  const double sy = std::sin(yaw), cy = std::cos(yaw);
  const double sp = std::sin(pitch), cp = std::cos(pitch);
  return {cy * cp * yaw_rate - sy * sp * pitch_rate, cp * pitch_rate,
          -sy * cp * yaw_rate - cy * sp * pitch_rate};
}

Pose rcm_frame(const Vector3& s_home, const Vector3& p_BRcm) {
  const Vector3 z = s_home.normalized();
  Vector3 x = lateral(Vector3::UnitX(), z);
  if (x.norm() < 0.1) x = lateral(Vector3::UnitY(), z);  // base x runs along the shaft
  x.normalize();
  Pose X_BR = Pose::Identity();
  X_BR.linear().col(0) = x;
  X_BR.linear().col(1) = z.cross(x);
  X_BR.linear().col(2) = z;
  X_BR.translation() = p_BRcm;
  return X_BR;
}

double wrapped(double angle) { return std::remainder(angle, 2 * M_PI); }

Matrix3 minimal_rotation(const Vector3& a, const Vector3& b) {
  const Vector3 w = a.cross(b);
  const double x = w.x(), y = w.y(), z = w.z();
  // Opposite directions have no unique minimal rotation; the cone limit keeps the shaft far from
  // there.
  const double d = std::max(1.0 + a.dot(b), 1e-9);
  const double per_d = 1 / d, xd = x * per_d, yd = y * per_d, zd = z * per_d;
  const double xx = x * xd, yy = y * yd, zz = z * zd, xy = x * yd, xz = x * zd, yz = y * zd;
  Matrix3 R;  // I + [w] + [w]^2 / (1 + a . b), written out: it is asked for at every point ahead
  R << 1 - zz - yy, xy - z, xz + y,  //
      xy + z, 1 - zz - xx, yz - x,   //
      xz - y, yz + x, 1 - yy - xx;
  return R;
}

Matrix3 shaft_rotation(const Vector3& s_R, double roll) {
  return minimal_rotation(Vector3::UnitZ(), s_R) *
         Eigen::AngleAxisd(roll, Vector3::UnitZ()).toRotationMatrix();
}

double absolute_roll(const Matrix3& R, const Matrix3& R_home, const Vector3& s_home,
                     const Vector3& s) {
  // D = R R_home^T = minimal_rotation(s_home, s) exp(psi s_home) has the quaternion (w, v) with
  // tan(psi / 2) = v . s_home / w, as the swing turns across s_home. Of that the double angle, in
  // products of w and v that D's entries give, so that no half turn is near a division by zero:
  // 4 w v is the vector of D - D^T, and 2 (w^2 - (v . s_home)^2) = tr D - s_home . s.
  Vector3 skew = Vector3::Zero();
  double trace = 0;
  for (int i = 0; i < 3; ++i) {  // D is the sum of the columns' outer products
    const Vector3 home = R_home.col(i), now = R.col(i);
    skew += home.cross(now);
    trace += home.dot(now);
  }
  return std::atan2(s_home.dot(skew), trace - s_home.dot(s));
}

double roll_holonomy_rate(const Vector3& s_home, const Vector3& s, const Vector3& s_dot) {
  // The minimal rotation to s(t) turns about s at -(s_home . (s x s_dot)) / (1 + s_home . s): the
  // solid angle that the shaft sweeps. Without this term every closed loop of the tip would roll
  // the instrument.
  return -s_home.dot(s.cross(s_dot)) / std::max(1.0 + s_home.dot(s), 1e-9);
}

}  // namespace surg
