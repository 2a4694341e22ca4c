// Whether a measured joint state can be, after the ones before it.
#pragma once

#include <array>

#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Compares the positions with the integral of the velocities, joint by joint. A joint whose
/// position jumps, wraps, stands still or drifts against its velocity is found; the state is not
/// used then. The time between two states is what all joints say together: states come early and
/// late, and the clock of a slow simulator runs slowly. Continuous joints, whose drivers may wrap
/// them by full turns, are unwrapped first.
class StateCheck {
 public:
  enum class Verdict { kGood, kImplausible, kLost };

  static constexpr double kSlack = 0.01;    ///< [rad] noise of positions
  static constexpr double kFilter = 0.004;  ///< [s] by which velocities may be filtered
  static constexpr double kJitter = 0.05;   ///< [s] by which a state may have come late
  static constexpr double kGap = 0.01;      ///< [s] without a state; the comparison begins anew
  static constexpr int kLost = 5;           ///< [cycles] in a row of what cannot be

  /// home [rad]: a continuous joint starts within half a turn of it. acceleration [rad/s^2]: of
  /// each joint.
  StateCheck(const Chain& chain, const JointVector& home, const JointVector& acceleration);

  /// Judges a state and completes it: q is unwrapped, and an implausible state is replaced by the
  /// last good one, moved on at its velocity. After kLost cycles the check starts anew from what is
  /// measured. age [s] of the state; elapsed [s] since the last call.
  Verdict judge(JointVector& q, JointVector& qd, double age, double elapsed);
  /// Takes the next state as it is: nothing follows this arm, or its state was lost.
  void restart() { started_ = false; }

 private:
  void unwrap(JointVector& q) const;
  void take(const JointVector& q, const JointVector& qd, double age);

  std::array<bool, kMaxJoints> continuous_{};
  JointVector acceleration_;
  JointVector q_, qd_, drift_;  // the last good state; position less integrated velocity
  double age_ = 0, since_ = 0;  // [s] its age then; since it was taken
  int bad_ = 0;                 // [cycles] in a row
  bool started_ = false;
};

}  // namespace surg
