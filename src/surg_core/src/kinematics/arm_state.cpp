#include "surg_core/kinematics/arm_state.hpp"

#include <cmath>

namespace surg {

ArmState::ArmState(const Chain& chain, const Tool& tool, double link_lag, double dt)
    : chain_(chain),
      tool_(tool),
      lag_(link_lag),
      dt_(dt),
      in_flight_(JointVector::Zero(chain.dof())) {
  for (Sight* sight : {&now_, &ahead_}) {
    sight->q = JointVector::Zero(chain.dof());
    sight->J = Jacobian::Zero(6, chain.dof());
  }
}

void ArmState::look(const JointVector& q, const Vector3& p_BRcm, Sight& sight) const {
  sight.q = q;
  chain_.forward(q, sight.X_BF, sight.J);
  sight.p_BRcm = p_BRcm;
  sight.shaft = shaft_state(sight.X_BF, tool_, p_BRcm);
  if (!homed_) return;
  const double roll = absolute_roll(sight.X_BF.linear(), R_home_, s_home_, sight.shaft.s);
  sight.roll += wrapped(roll - sight.roll);  // continues through half turns
}

void ArmState::sense(const JointVector& q, const JointVector& qd, const Trocar& trocar) {
  look(q, trocar.p_B(), now_);
  const Vector6 twist = now_.J * qd;
  const Vector3 omega = twist.tail<3>();
  const ShaftState& shaft = now_.shaft;
  v_BTip_ = twist.head<3>() + omega.cross(Vector3(shaft.p_BTip - shaft.p_BF));
  s_dot_ = omega.cross(shaft.s);
  // omega . s is roll plus the holonomy of the swing.
  roll_rate_ = omega.dot(shaft.s) - roll_holonomy_rate(s_home_, shaft.s, s_dot_);
  // The law acts where its command will take effect, not where the arm was when it was measured.
  // Without this a lag of 12 ms costs 8 % overshoot of the tip at 2 Hz and most of the pivot's
  // deviation.
  ahead_.roll = now_.roll;
  if (lag_ > 0) {
    look(JointVector(q + in_flight_), Vector3(trocar.p_B() + lag_ * trocar.v_B()), ahead_);
  } else {
    ahead_ = now_;
  }
}

void ArmState::take_home() {
  s_home_ = now_.shaft.s;
  R_home_ = now_.X_BF.linear();
  homed_ = true;
  now_.roll = ahead_.roll = 0;
}

void ArmState::remember(const JointVector& qd_command) {
  // First-order model of the link: what was commanded arrives with time constant link_lag.
  if (lag_ <= 0) return;
  const double keep = std::exp(-dt_ / lag_);
  in_flight_ = keep * in_flight_ + lag_ * (1 - keep) * qd_command;
}

}  // namespace surg
