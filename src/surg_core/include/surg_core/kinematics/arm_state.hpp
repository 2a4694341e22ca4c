// What a joint state says about the instrument: where it is now, and where the coming command will
// find it.
#pragma once

#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/kinematics/trocar.hpp"
#include "surg_core/law/rcm.hpp"
#include "surg_core/state/snapshot.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Pose of the instrument at one joint position.
struct Sight {
  JointVector q;  ///< [rad]
  Pose X_BF = Pose::Identity();
  Jacobian J;  ///< of the flange
  Vector3 p_BRcm = Vector3::Zero();
  ShaftState shaft{};
  double roll = 0;  ///< absolute, continuous [rad]; 0 until homed
};

template <>
struct IsPlain<Sight> : std::true_type {};

class ArmState {
 public:
  /// link_lag [s]: from a velocity command to the motion it causes; 0: no look-ahead.
  ArmState(const Chain& chain, const Tool& tool, double link_lag, double dt);

  /// A finite joint state of the right size. 'trocar' is where the pivot is now.
  void sense(const JointVector& q, const JointVector& qd, const Trocar& trocar);
  /// The trocar has been taught anew.
  void look_again(const Trocar& trocar) { look(now_.q, trocar.p_B(), now_); }
  /// The present shaft and orientation become the reference of roll.
  void take_home();
  /// A command has gone out: until it is measured it is in flight.
  void remember(const JointVector& qd_command);

  const Chain& chain() const { return chain_; }
  const Tool& tool() const { return tool_; }
  const Sight& now() const { return now_; }
  const Sight& ahead() const { return ahead_; }
  const Vector3& s_home() const { return s_home_; }
  const Matrix3& R_home() const { return R_home_; }
  const Vector3& v_BTip() const { return v_BTip_; }  ///< measured tip velocity [m/s]
  const Vector3& s_dot() const { return s_dot_; }    ///< measured rate of the shaft axis [1/s]
  double roll_rate() const { return roll_rate_; }    ///< measured [rad/s]
  /// Length of the shaft from the flange's plane to the tip [m].
  double shaft_length() const { return tool_.s_F.dot(tool_.p_FTip); }
  /// What an image of the controller needs of it: all but the frozen chain and tool (image.hpp).
  template <typename Image>
  void remembered(Image& image) {
    image(homed_, s_home_, R_home_, now_, ahead_, in_flight_, v_BTip_, s_dot_, roll_rate_);
  }

 private:
  void look(const JointVector& q, const Vector3& p_BRcm, Sight& sight) const;

  Chain chain_;
  Tool tool_;
  double lag_, dt_;
  bool homed_ = false;
  Vector3 s_home_ = Vector3::UnitZ();
  Matrix3 R_home_ = Matrix3::Identity();
  Sight now_, ahead_;
  JointVector in_flight_;  // [rad] commanded but not yet measured
  Vector3 v_BTip_ = Vector3::Zero(), s_dot_ = Vector3::Zero();
  double roll_rate_ = 0;
};

}  // namespace surg
