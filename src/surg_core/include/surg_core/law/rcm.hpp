// The remote-centre-of-motion law. Equation numbers refer to the paper (docs/design/paper.md).
#pragma once

#include "surg_core/types.hpp"

namespace surg {

/// Calibrated constants in the flange frame F.
struct Tool {
  Vector3 s_F = Vector3::UnitZ();    ///< unit shaft axis, flange to tip
  Vector3 p_FTip = Vector3::Zero();  ///< tip
};

/// Position of the instrument relative to its trocar; all vectors in B.
struct ShaftState {
  Vector3 p_BF;     ///< flange origin
  Vector3 p_BTip;   ///< tip
  Vector3 s;        ///< unit shaft axis, flange to tip
  Vector3 e;        ///< lateral vector from the shaft to the trocar; |e| is the RCM deviation
  Vector3 p_BNear;  ///< shaft point closest to the trocar
  double depth;     ///< insertion depth L [m], positive inside the patient
};

/// s = R s_F; L = s . (p_tip - p_rcm); e = p_rcm - p_tip + L s.
ShaftState shaft_state(const Pose& X_BF, const Tool& tool, const Vector3& p_BRcm);

/// Velocity form (docs/design/control_law.md): flange twist (v, omega) in B for a tip
/// velocity, a roll rate about the shaft, pivot velocity v_rcm and lateral feedback k [1/s]. Exact
/// tip velocity; |e| decays at rate k. 'depth_floor' > 0 bounds 1/L near the trocar.
Vector6 rcm_twist(const ShaftState& shaft, const Vector3& v_BTip, double roll_rate,
                  const Vector3& v_BRcm, double gain, double depth_floor);

/// The paper's equations exactly as printed, Cartesian: eqs. (1)-(7).
Vector6 paper_cartesian_twist(const Vector3& p_ee, const Vector3& p_tip, const Vector3& p_rcm,
                              const Vector3& v_tip, double roll_rate);
/// The paper's spherical law exactly as printed: eqs. (8)-(9); rates about base x and y.
Vector6 paper_spherical_twist(const Vector3& p_ee, const Vector3& p_rcm, double pitch_rate,
                              double yaw_rate, double roll_rate, double v_trans);

/// The trocar frame's angles: s = (sin yaw cos pitch, sin pitch, cos yaw cos pitch), in the rcm
/// frame.
Vector3 shaft_direction(double yaw, double pitch);
/// (yaw, pitch) of a unit direction in the rcm frame.
Eigen::Vector2d shaft_angles(const Vector3& s_R);
/// d(direction)/dt for given rates, in the rcm frame.
Vector3 shaft_direction_rate(double yaw, double pitch, double yaw_rate, double pitch_rate);

/// X_BR, the rcm frame: origin trocar, z the home shaft axis into the patient, x = base x made
/// perpendicular to z (base y where base x runs along the shaft).
Pose rcm_frame(const Vector3& s_home, const Vector3& p_BRcm);

/// The same angle [rad] within half a turn.
double wrapped(double angle);

/// Rotation of least angle taking unit a to unit b.
Matrix3 minimal_rotation(const Vector3& a, const Vector3& b);
/// R_RShaft of a shaft in the rcm frame: the least rotation from z to it, after the roll about z.
Matrix3 shaft_rotation(const Vector3& s_R, double roll);
/// Absolute roll psi in R = minimal_rotation(s_home, s) exp(psi s_home) R_home, in (-pi, pi].
double absolute_roll(const Matrix3& R, const Matrix3& R_home, const Vector3& s_home,
                     const Vector3& s);
/// omega . s that keeps psi constant while the shaft turns with s_dot (the holonomy term).
double roll_holonomy_rate(const Vector3& s_home, const Vector3& s, const Vector3& s_dot);

}  // namespace surg
