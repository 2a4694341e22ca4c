// State and methods of a controller behind its public class (controller.hpp). controller.cpp has
// the order of a cycle, controller_state.cpp states and requests, controller_guards.cpp inputs and
// guards, controller_motion.cpp commands and motion.
#pragma once

#include "controller/command_history.hpp"
#include "surg_core/controller.hpp"
#include "surg_core/kinematics/arm_state.hpp"
#include "surg_core/kinematics/trocar.hpp"
#include "surg_core/law/exact_follower.hpp"
#include "surg_core/law/twist_law.hpp"
#include "surg_core/limits/limited_step.hpp"
#include "surg_core/limits/stop_bound.hpp"
#include "surg_core/motion/command_handler.hpp"
#include "surg_core/motion/elbow_motion.hpp"
#include "surg_core/motion/jaw.hpp"
#include "surg_core/motion/joint_trace.hpp"
#include "surg_core/state/cycle_clock.hpp"
#include "surg_core/state/gate.hpp"
#include "surg_core/state/lag_meter.hpp"
#include "surg_core/state/snapshot.hpp"
#include "surg_core/state/standstill_guard.hpp"
#include "surg_core/state/state_check.hpp"

namespace surg {

/// F01: refuses NaN, infinity and values such as 1e308, whose square is not finite.
template <typename Derived>
bool finite(const Eigen::MatrixBase<Derived>& v) {
  constexpr double kHuge = 1e6;  // [m, rad] no command or trocar is ever so large
  return (v.array().abs() < kHuge).all();
}

/// Shaft axis and end: the tip of a straight instrument, the wrist centre of another.
Tool shaft_of(const InstrumentConfig& instrument, const ToolCalibration& tool);

struct Controller::Impl {
  // Frozen.
  RobotConfig robot;
  Limits limits;
  Law law;
  bool track_rcm;
  bool passive;  // no tool link, and a jaw that stays 0
  double T;
  Gains gains;

  CycleClock clock;
  CommandHistory commanded;
  OperatingState operating;
  Authority authority;
  Trocar trocar;
  ArmState arm;
  CommandHandler handler;
  Jaw jaw;
  ForceGuard force;
  LimitedStep limited;
  ClearanceGuard clearance;
  ExactFollower follower;
  LagMeter lag_meter;
  ElbowMotion elbow;
  JointTrace trace;  // the way back
  StopEstimator stops;
  StandstillGuard standstill;
  StateCheck state_check;

  Fixtures fixtures;  // in B; the handler has them in R

  Pose X_BR = Pose::Identity();
  double state_delay = 0;                   // [s] recent age of states beyond one period
  bool state_known = false;                 // the last step had a finite, fresh joint state
  Reason state_reason = Reason::kLinkLost;  // why not
  Reason robot_reason = Reason::kNone;      // why the robot does not obey
  Reason track_reason = Reason::kNone;      // why the trocar's last sample was not taken
  Trocar trocar_before;                     // before this cycle's sample, if it is tracked
  bool inserted = false;                    // the trocar lies on the shaft and must stay there
  bool tool_lost = false;
  bool elbow_asked = false;  // in this cycle; judging a command takes up to 0.3 ms
  bool fading = false;       // the last command fades without feedback until the next start
  bool catching_up = false;  // inside a period that has passed without a cycle
  int home_busy = 0;
  double unreachable = 0;  // [s] for which the last hold is still named
  int unexplained = 0;     // [cycles] in a row
  JointVector q, qd;       // the joint state in use; meaningless unless state_known
  JointVector qd_last;
  double retraced = 0;          // [rad] of the trace
  bool retrace_active = false;  // in the last step; a retrace first waits for rest
  double retrace_settling = 0;  // [s] at the end of the trace
  // The reference starts at the arm's position, off the pivot by its error, and converges smoothly.
  Vector3 pivot_offset = Vector3::Zero(), pivot_offset_rate = Vector3::Zero();
  Outputs out;

  Impl(const Chain& chain, const RobotConfig& robot_in, const Limits& limits_in,
       const InstrumentConfig& instrument, const ToolCalibration& tool, const Options& options,
       const ClearanceSetup& clearance_in);

  // State and requests.
  bool enabled() const { return operating.state() == State::kEnabled; }
  const ShaftState& shaft() const { return arm.measured().shaft; }
  /// Conditions for 'enable' and 'resume'; a persisting cause is returned as the reason.
  Conditions conditions() const;
  /// Whether the arm is decelerating because the trocar left the shaft. The stop then keeps the
  /// pivot that it began with.
  bool stopping_off_pivot() const;
  /// The shaft's line passes through the trocar, in front of the flange.
  bool shaft_through_trocar() const;
  TipPose tip_pose() const;
  /// The tip behind the wrist, in the rcm frame.
  TipFrame tip_behind_wrist(const Vector3& p_RCentre, const Vector3& s_R, double roll,
                            const WristJoints& joints) const;
  Reason request(StateCommand command);
  Reason set_rcm(const Vector3& p_BRcm);
  Reason set_fixture(const Fixture& fixture);
  Reason remove_fixture(std::string_view name);
  /// Hands the regions to the set-point, after they or the rcm frame have changed.
  void place_fixtures();
  Reason change_tool(const InstrumentConfig& instrument, const ToolCalibration& calibration);
  /// Whether the arm moves under this controller.
  bool is_moving() const;
  /// Whether the reference (or the last command) is at rest; what remains only holds the position.
  bool reference_at_rest() const;
  /// Whether the ramp is over and zero is within one cycle's acceleration of the last command.
  bool may_stop_at_once() const;
  void set_home();
  /// Puts the set-point at rest at the arm's position and drops all targets.
  void start_at_rest();
  void stop_motion();
  void fault(Reason reason);
  void pause(Reason reason);
  /// Ends the motion in progress: the set-point stops at once, and the last command fades, each
  /// joint within its acceleration limit. It needs no joint state.
  void fade();

  // Inputs, guards and gate.
  /// Set-point, reference and timers go on over the periods that passed without a cycle. The jaw
  /// does not: its command is a position, which would jump.
  void catch_up();
  /// Timers, motion, jaw and authority go on, unless the cycle came between two periods.
  void advance();
  /// Reports a reason, if there is one.
  void note(Reason reason);
  void elapse_authority();
  void sense(const Inputs& in);
  /// Takes the measured joint state where it can be; otherwise says why not.
  Reason take_state(const Inputs& in);
  /// Whether the arm stands within its joint limits.
  bool within_joint_limits() const;
  void measure_lag(const Inputs& in);
  /// F33: a robot that does not obey is told nothing, so that it does not leap when it obeys again.
  void guard_robot(const Inputs& in);
  void measure_clearance(const Inputs& in);
  /// F27: after a gap continues from the arm's measured velocity, or stops if the link has stopped
  /// the arm meanwhile.
  void guard_lateness();
  /// Pauses an arm whose joints move otherwise than any recent command, or stand still against
  /// them.
  void guard_following();
  bool joints_are_unexplained();
  bool stands_still();
  /// Brakes from the measured velocity; the motion in progress is over.
  void stop_from_measured(Reason reason);
  /// Factor of the feedback gain in (0, 1] for late states. A loop becomes unstable at a gain times
  /// delay of about 1.5; 0.6 is well damped and must not grow with the age of the states.
  double feedback_scale() const;
  void update_trocar(const Inputs& in);
  /// F31: without the tool link, arm and jaw hold.
  void check_tool_link(const Inputs& in);
  /// F23: stops an arm that is off the trocar or does not follow.
  void guard_pivot();
  /// [m] Where the tip of an arm is that follows its commands as the link's lag says, in B. The
  /// velocity form has no reference: it is the set-point.
  Vector3 expected_tip() const;
  /// F25: yields to the force at the tip, pauses, stops or fades.
  void guard_force(const Inputs& in);
  void gate(const Inputs& in);
  Reason accept(const MotionCommand& command);
  Reason turn_elbow(const MotionCommand& command);

  // Motion: set-point, law, limits, follower.
  void move();
  /// Whether set-point and arm move through the law.
  bool follows_setpoint() const;
  /// One period of the set-point and of the arm behind it.
  Step advance_motion(JointVector& qd);
  void yield_return();
  void advance_setpoint(const Step& step, const Setpoint& next);
  void output_command(JointVector qd, bool moving);
  Step next_step(const Setpoint& next, JointVector& qd);
  /// Exact form: the next step of the reference, and the command with which the arm follows it.
  Step exact_step(const Setpoint& next, JointVector& qd);
  /// Moves the reference by a step and returns the command with which the arm follows it. p_BPivot:
  /// where the shaft shall be now.
  JointVector follow(const Step& step, const Vector3& p_BPivot);
  /// The force at the tip while the force guard yields, as the follower needs it.
  ExactFollower::Push push_on_joints() const;
  /// Velocity form and the paper's law, from the measured state predicted for the command.
  Step velocity_step(const Setpoint& next, JointVector& qd) const;
  /// Ends a retrace: the trace continues from the point that was reached.
  void end_retrace_step();
  /// Retraces the joint trace once the previous motion is at rest; the set-point follows.
  Step retrace_step(JointVector& qd);
  TwistParts twist_for(const Setpoint& next) const;
  /// Goal in t [s] of the set-point's clock; the trocar is at its position after this cycle.
  /// 'next': the set-point one cycle later, from which it is predicted.
  ShaftGoal goal_at(const Setpoint& next, double t) const;
  /// [s] of look-ahead; 0 for streams: future samples are unknown, and a wrong prediction would
  /// slow the stream down. Barrier and braking distances limit streams.
  double horizon() const;
  /// Null-space pull to the home posture [rad/s].
  JointVector posture_at(const JointVector& q) const;
  /// A wish for the null space at joints q, smaller where it brings the arm to another one: alpha,
  /// with which the clearance guard slows the arm down, does not scale it.
  JointVector clear_posture(const JointVector& q, const JointVector& posture) const;
  /// Resets the set-point to the tip's true motion after this step.
  void resync_setpoint(const JointVector& qd);
  /// The last command, decelerated to zero without feedback: a joint that is blocked must not jump
  /// to its reference when it is released.
  JointVector fading_command(int periods = 1) const;
  /// [m/s] flange speed needed by the follower's correction. The reference leaves it free, since a
  /// command that is cut short would leave the pivot.
  double flange_lead() const;
  /// [s] until the slowest joint to brake is at rest, from joint velocities.
  double time_to_rest(const JointVector& of) const;
  /// In FAULT no joint state makes the arm faster: where the law wants to, the command fades.
  JointVector no_faster(const JointVector& qd_wanted);

  // Report and snapshot.
  void report(const Inputs& in);
  void report_virtual_joints();
  void report_stop_bound(const Inputs& in);
  void report_wrist(const Inputs& in);
  /// The drive's joints: measured, or else where they are set.
  DriveJoints driven(const Inputs& in) const;
  /// Serializes every member that a step reads before writing it; a test finds a missing one.
  template <typename Archive>
  void serialize(Archive& archive) {
    archive(clock, commanded, operating, authority, trocar, handler, jaw, force, lag_meter,
            standstill, state_check);
    arm.serialize(archive);
    follower.serialize(archive);
    elbow.serialize(archive);
    clearance.serialize(archive);
    archive(stops.commands());
    archive(trace, retraced, retrace_active, retrace_settling, pivot_offset, pivot_offset_rate,
            fixtures, X_BR, state_delay, state_known, state_reason, robot_reason, track_reason,
            inserted, tool_lost, fading, home_busy, unreachable, unexplained, qd_last, out.accepted,
            out.refused, out.clearance);
  }
};

}  // namespace surg
