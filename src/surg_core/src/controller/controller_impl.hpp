// What a controller remembers and does; Controller (controller.hpp) is its face. Private: state and
// requests are in controller_state.cpp, senses and guards in controller_guards.cpp, what becomes of
// commands and motion in controller_motion.cpp, the order of a cycle in controller.cpp.
#pragma once

#include "surg_core/controller.hpp"
#include "surg_core/kinematics/arm_state.hpp"
#include "surg_core/kinematics/trocar.hpp"
#include "surg_core/law/exact_follower.hpp"
#include "surg_core/law/twist_law.hpp"
#include "surg_core/limits/limited_step.hpp"
#include "surg_core/motion/command_handler.hpp"
#include "surg_core/motion/jaw.hpp"
#include "surg_core/motion/joint_trace.hpp"
#include "surg_core/state/gate.hpp"
#include "surg_core/state/snapshot.hpp"

namespace surg {

/// F01: 1e308 is finite and still poison (its square is not). Written so that NaN is refused.
template <typename Derived>
bool finite(const Eigen::MatrixBase<Derived>& v) {
  constexpr double kHuge = 1e6;  // [m, rad] no command or trocar is ever so large
  return (v.array().abs() < kHuge).all();
}

template <>
struct IsPlain<Trocar> : std::true_type {};
template <>
struct IsPlain<Pilot> : std::true_type {};
template <>
struct IsPlain<JointTrace> : std::true_type {};
template <>
struct IsPlain<ForceGuard> : std::true_type {};

struct Controller::Impl {
  // Frozen.
  RobotConfig robot;
  Limits limits;
  Law law;
  bool track_rcm;
  double T;
  Gains gains;

  OperatingState operating;
  Authority authority;
  Trocar trocar;
  ArmState arm;
  Pilot pilot;
  Jaw jaw;
  ForceGuard force;
  LimitedStep limited;
  ExactFollower follower;
  JointTrace trace;  // the way back

  Pose X_BR = Pose::Identity();
  double stale = 0;                   // [s] how much older than a period states have lately been
  bool sensed = false;                // a finite, fresh joint state has been seen in the last step
  Reason unseen = Reason::kLinkLost;  // why not
  Reason untracked = Reason::kNone;   // why the trocar's last sample was not taken
  Trocar steady;                      // the trocar before this cycle's sample
  bool inserted = false;              // the trocar point lies on the shaft, and must go on doing so
  bool tool_lost = false;
  bool halted = false;  // zero at once and until the arm starts anew
  int home_busy = 0;
  JointVector qd_last;
  double back = 0;         // [rad] of the trace that 'retrace' has gone back
  bool replaying = false;  // in the last step: 'retrace' first waits for rest
  // The reference starts where the arm is, off the pivot by its error, and comes onto it smoothly.
  Vector3 pivot_offset = Vector3::Zero(), pivot_offset_rate = Vector3::Zero();
  Outputs out;

  Impl(const Chain& chain, const RobotConfig& robot_in, const Limits& limits_in,
       const InstrumentConfig& instrument, const ToolCalibration& tool, const Options& options);

  // State and requests.
  bool enabled() const { return operating.state() == State::kEnabled; }
  const ShaftState& shaft() const { return arm.now().shaft; }
  /// A cause that lasts refuses 'enable' and 'resume' by its own name.
  Conditions conditions() const;
  /// On the way to rest after the trocar has left the shaft: the stop keeps to the pivot that it
  /// began on, and does not run after wherever the point is now.
  bool torn() const;
  /// The shaft's line passes through the trocar, in front of the flange.
  bool on_line() const;
  Whereabouts whereabouts() const;
  Reason request(StateCommand command);
  Reason set_rcm(const Vector3& p_BRcm);
  /// The arm moves, and its controller knows how.
  bool ramping() const;
  /// What leads the arm is at rest; what is left only holds it in place.
  bool commands_rest() const;
  void take_home();
  /// The set-point is where the arm is; every target is gone.
  void start_here();
  void leave_enabled();
  void fault(Reason reason);
  void pause(Reason reason);
  /// Halt: the set-point stands still at once, and the arm with it.
  void freeze();

  // Senses, guards and gate.
  void sense(const Inputs& in);
  /// In (0, 1]: share of the feedback's gain that late states leave: a loop shakes once gain times
  /// delay is about 1.5, so that what is 0.6 with fresh states must not grow with their age.
  double trust() const;
  void follow_trocar(const Inputs& in);
  /// F31: without the tool link the arm holds, and so does the jaw.
  void watch_tool(const Inputs& in);
  /// F23: away from the trocar nothing may go on.
  void guard_pivot();
  /// F25: yields to the force at the tip, stops or halts.
  void guard_force(const Inputs& in);
  void gate(const Inputs& in);
  Reason take(const MotionCommand& command);

  // Motion: set-point, law, limits, follower.
  void move();
  void advance_setpoint(const Step& step, const Setpoint& next);
  void command(JointVector qd, bool moving);
  Step next_step(const Setpoint& next, JointVector& qd);
  /// Exact form: the reference's next step, and what makes the link follow it.
  Step exact_step(const Setpoint& next, JointVector& qd);
  /// Velocity form and the paper's law: from the measured state, where the command will find it.
  Step velocity_step(const Setpoint& next, JointVector& qd) const;
  /// 'retrace' has ended, or something ended it: the trace leads on from where it has gone back to.
  void end_replay();
  /// Back along the trace, once the motion before has come to rest; the set-point goes along.
  Step retrace_step(JointVector& qd);
  TwistWish wish_for(const Setpoint& next) const;
  /// Where the set-point leads in t [s] of its own clock; the trocar is where it will be after this
  /// cycle. 'next': the set-point a whole cycle on, from where it is only foreseen.
  ShaftGoal goal_at(const Setpoint& next, double t) const;
  /// What a stream will do is its sender's secret: a look ahead along a guess would slow it down
  /// for nothing. Barrier and braking distances guard it.
  double horizon() const;
  JointVector posture_at(const JointVector& q) const;
  /// The set-point goes on from where the tip will be: of the reference, or of the arm.
  void slip(const JointVector& qd);
  /// The last command on its way to zero. Nothing is followed any more: a joint that was held from
  /// elsewhere must not run after its reference once it is released.
  JointVector fading_command() const;
  /// [m/s] What the follower's correction takes of the flange's speed: the reference leaves it that
  /// room, as a command that is cut short would be off the pivot.
  double flange_lead() const;

  // Report and image.
  void report(const Inputs& in);
  void report_virtual_joints();
  /// Every member that a step reads before it writes it; a test finds the one that is missing.
  template <typename Image>
  void remembered(Image& image) {
    image(operating, authority, trocar, pilot, jaw, force);
    arm.remembered(image);
    follower.remembered(image);
    image(trace, back, replaying, pivot_offset, pivot_offset_rate, X_BR, stale, sensed, unseen,
          untracked, inserted, tool_lost, halted, home_busy, qd_last, out.accepted, out.refused);
  }
};

}  // namespace surg
