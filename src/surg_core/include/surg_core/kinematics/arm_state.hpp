// The instrument's pose and motion computed from a joint state: as measured, and as predicted for
// the time when the next command takes effect.
#pragma once

#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/kinematics/trocar.hpp"
#include "surg_core/law/rcm.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Pose of the instrument at one joint position.
struct InstrumentState {
  JointVector q;  ///< [rad]
  Pose X_BF = Pose::Identity();
  Jacobian J;  ///< of the flange
  Vector3 p_BRcm = Vector3::Zero();
  ShaftState shaft{};
  double roll = 0;  ///< absolute, continuous [rad]; 0 until homed
};

class ArmState {
 public:
  /// lag [s]: of each joint, from a velocity command to the motion; 0: no prediction.
  ArmState(const Chain& chain, const Tool& tool, const JointVector& lag, double dt);

  /// Updates from a finite joint state of the right size. 'trocar' is the present pivot.
  void sense(const JointVector& q, const JointVector& qd, const Trocar& trocar);
  /// Recomputes the measured state for a newly taught trocar.
  void update_trocar(const Trocar& trocar) { evaluate(measured_.q, trocar.p_B(), measured_); }
  /// Another instrument: the measured state as seen with it.
  void mount(const Tool& tool, const Trocar& trocar);
  /// Makes the present shaft and orientation the zero of roll.
  void set_home();
  /// Adds a command to the motion that is commanded but not yet measured.
  void record_command(const JointVector& qd_command);

  const Chain& chain() const { return chain_; }
  const Tool& tool() const { return tool_; }
  const InstrumentState& measured() const { return measured_; }
  const InstrumentState& predicted() const { return predicted_; }
  const Vector3& s_home() const { return s_home_; }
  const Matrix3& R_home() const { return R_home_; }
  const Vector3& v_BTip() const { return v_BTip_; }  ///< measured tip velocity [m/s]
  const Vector3& s_dot() const { return s_dot_; }    ///< measured rate of the shaft axis [1/s]
  double roll_rate() const { return roll_rate_; }    ///< measured [rad/s]
  /// Length of the shaft from the flange's plane to the tip [m].
  double shaft_length() const { return tool_.s_F.dot(tool_.p_FTip); }
  /// Serializes everything but the frozen chain and tool (snapshot.hpp).
  template <typename Archive>
  void serialize(Archive& archive) {
    archive(homed_, s_home_, R_home_, measured_, predicted_, in_flight_, v_BTip_, s_dot_,
            roll_rate_);
  }

 private:
  void evaluate(const JointVector& q, const Vector3& p_BRcm, InstrumentState& state) const;

  Chain chain_;
  Tool tool_;
  double lag_;                // [s] of the slowest joint
  JointVector keep_, enter_;  // of the motion in flight per cycle; [s] of a command
  bool homed_ = false;
  Vector3 s_home_ = Vector3::UnitZ();
  Matrix3 R_home_ = Matrix3::Identity();
  InstrumentState measured_, predicted_;
  JointVector in_flight_;  // [rad]
  Vector3 v_BTip_ = Vector3::Zero(), s_dot_ = Vector3::Zero();
  double roll_rate_ = 0;
};

}  // namespace surg
