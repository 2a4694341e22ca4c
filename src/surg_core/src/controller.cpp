#include "surg_core/controller.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "surg_core/arm_state.hpp"
#include "surg_core/exact_follower.hpp"
#include "surg_core/flange_cap.hpp"
#include "surg_core/gate.hpp"
#include "surg_core/image.hpp"
#include "surg_core/jaw.hpp"
#include "surg_core/joint_trace.hpp"
#include "surg_core/law.hpp"
#include "surg_core/limited_step.hpp"
#include "surg_core/limits.hpp"
#include "surg_core/pilot.hpp"
#include "surg_core/trocar.hpp"

namespace surg {
namespace {

constexpr double kFollowDistance = 0.01;   // [m] set-point to measured tip: more means a stuck arm
constexpr double kStandstill = 0.05;       // alpha below it: the limit has stopped the arm
constexpr double kOutside = 0.15;          // [m] a tip may be above its trocar before 'insert'
constexpr double kToolTimeout = 0.2;       // [s] without a jaw state (F31)
constexpr double kPositionReserve = 0.01;  // [rad] a lagging joint swings past its command
constexpr double kFlangeReserve = 0.97;  // of its speed: it is looked at to first order, not ahead
constexpr double kMostLead = 0.5;        // of it: the follower may not bring the reference to rest
constexpr double kOntoPivot = 8;       // [1/s] pole with which a start off the pivot comes onto it
constexpr double kHorizon = 0.45;      // [s] of the set-point's clock that is looked ahead
constexpr double kRetraceRate = 0.15;  // [rad/s] of the fastest joint
constexpr double kStill = 1e-3;        // [rad, rad/s] nothing that anybody would see
constexpr double kCreep = 5e-3;        // [rad/s] may be dropped in one cycle
constexpr double kSame = 0.02;         // [rad] an arm at rest is still where it was
constexpr double kHuge = 1e6;          // [m, rad] no command or trocar is ever so large
constexpr int kHomeBusyCycles = 5;     // is_busy needs an edge that a client can see

/// F01: 1e308 is finite and still poison (its square is not). Written so that NaN is refused.
template <typename Derived>
bool finite(const Eigen::MatrixBase<Derived>& v) {
  return (v.array().abs() < kHuge).all();
}

bool finite(const MotionCommand& command) {
  return finite(command.p) && finite(command.rotation.coeffs()) && finite(command.joints) &&
         std::abs(command.roll_rate) < kHuge && std::abs(command.jaw) < kHuge;
}

/// Knowing the link's lag belongs to the feedback: open loops do without.
double lag_for(const RobotConfig& robot, const Controller::Options& options) {
  const bool open = options.law == Law::kPaper || options.feedback_gain == 0;
  return open ? 0.0 : robot.tuning.link_lag;
}

/// What the step may ask of the joints. The virtual reference leaves the follower a reserve.
JointLimits step_limits(const RobotConfig& robot, const Limits& limits, Law law) {
  JointLimits out = joint_limits(robot, limits);
  if (law == Law::kExact) {
    out.velocity *= ExactFollower::kReferenceVelocity;
    out.acceleration *= ExactFollower::kReferenceAcceleration;
  }
  out.flange_velocity *= kFlangeReserve;
  out.position_min.array() += kPositionReserve;
  out.position_max.array() -= kPositionReserve;
  return out;
}

ExactFollower::Options follower_options(const RobotConfig& robot, const Limits& limits, double gain,
                                        double lag, double T) {
  ExactFollower::Options out;
  out.lag = lag;
  out.gain = gain;
  out.T = T;
  out.velocity = robot.velocity;
  out.acceleration = robot.acceleration;
  out.flange_velocity = limits.flange_velocity;
  return out;
}

}  // namespace

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
       const InstrumentConfig& instrument, const ToolCalibration& tool, const Options& options)
      : robot(robot_in),
        limits(limits_in),
        law(options.law),
        track_rcm(options.track_rcm),
        T(options.dt),
        gains{options.feedback_gain >= 0 ? options.feedback_gain : robot_in.tuning.rcm_gain,
              robot_in.tuning.tip_gain, robot_in.tuning.roll_gain},
        authority(options.dt),
        arm(chain, {tool.s_F, tool.p_FTip},
            options.law == Law::kExact ? 0.0 : lag_for(robot_in, options), options.dt),
        pilot(limits_in, robot_in.tuning, options.dt, options.law == Law::kPaper),
        jaw(instrument, options.dt),
        force(limits_in),
        limited(chain, {tool.s_F, tool.p_FTip}, step_limits(robot_in, limits_in, options.law),
                options.dt),
        follower(chain.dof(), follower_options(robot_in, limits_in, gains.rcm,
                                               lag_for(robot_in, options), options.dt)),
        qd_last(JointVector::Zero(chain.dof())) {
    out.qd_command = qd_last;
  }

  bool enabled() const { return operating.state() == State::kEnabled; }
  const ShaftState& shaft() const { return arm.now().shaft; }

  /// A cause that lasts refuses 'enable' and 'resume' by its own name.
  Conditions conditions() const {
    Conditions now;
    now.state = sensed ? Reason::kNone : unseen;
    if (trocar.taught()) now.rcm = untracked;
    if (now.rcm == Reason::kNone && (torn() || !on_line() || shaft().depth <= -kOutside)) {
      now.rcm = Reason::kRcmError;
    }
    now.force_ok = force.acceptable();
    return now;
  }

  /// On the way to rest after the trocar has left the shaft: the stop keeps to the pivot that it
  /// began on, and does not run after wherever the point is now.
  bool torn() const {
    return operating.state() == State::kFault && operating.reason() == Reason::kRcmError &&
           ramping();
  }

  /// The shaft's line passes through the trocar, in front of the flange.
  bool on_line() const {
    return shaft().e.norm() <= limits.rcm_error_fault && shaft().depth < arm.shaft_length();
  }

  Whereabouts whereabouts() const {
    return {X_BR.inverse() * shaft().p_BTip, X_BR.linear().transpose() * shaft().s, arm.now().roll};
  }

  // --- state ----------------------------------------------------------------------------------

  Reason request(StateCommand command) {
    const State before = operating.state();
    // Clients home as a habit: on a homed arm that may be moving it changes nothing.
    const bool keep_home =
        command == StateCommand::kHome && operating.homed() && before == State::kEnabled;
    // A ramp that is under way goes on: dropped, its velocity would be gone in one cycle.
    const bool moving = ramping();
    if (command == StateCommand::kHome && !keep_home && moving) return Reason::kNotAtRest;
    const Reason reason = operating.request(command, conditions());
    if (reason != Reason::kNone) return reason;
    if (command == StateCommand::kHome) {
      home_busy = kHomeBusyCycles;
      if (!keep_home) take_home();
    }
    if (before == State::kEnabled && !enabled()) leave_enabled();
    if (before != State::kEnabled && enabled()) {
      if (moving) {
        pilot.stop();
        force.restart();
      } else {
        start_here();
      }
    }
    return Reason::kNone;
  }

  /// The arm moves, and its controller knows how.
  bool ramping() const {
    const bool known = sensed && !halted && operating.homed();
    return known && (pilot.setpoint().mode() != Setpoint::Mode::kRest || !commands_rest());
  }

  /// What leads the arm is at rest; what is left only holds it in place.
  bool commands_rest() const {
    const JointVector& qd = law == Law::kExact ? follower.velocity() : qd_last;
    return qd.cwiseAbs().maxCoeff() < kCreep;
  }

  /// The last command on its way to zero. Nothing is followed any more: a joint that was held from
  /// elsewhere must not run after its reference once it is released.
  JointVector fading_command() const { return braked_together(qd_last, robot.acceleration, T); }

  void take_home() {
    arm.take_home();
    X_BR = rcm_frame(shaft().s, trocar.p_BTaught());
    trace.clear();
    start_here();
  }

  /// The set-point is where the arm is; every target is gone.
  void start_here() {
    pilot.start(whereabouts());
    halted = false;
    follower.reset(arm.now().q, qd_last);
    const bool moved = !trace.empty() && (trace.at(0) - arm.now().q).cwiseAbs().maxCoeff() > kSame;
    if (moved) trace.clear();  // by hand: the way back begins elsewhere
    pivot_offset = -shaft().e;
    pivot_offset_rate.setZero();
    force.restart();
    inserted = shaft().depth >= limits.depth_min;
  }

  void leave_enabled() {
    pilot.stop();
    jaw.hold();
  }

  void fault(Reason reason) {
    operating.fault(reason);
    leave_enabled();
  }

  void pause(Reason reason) {
    if (!enabled()) return;
    operating.pause(reason);
    leave_enabled();
  }

  // --- sense ----------------------------------------------------------------------------------

  void sense(const Inputs& in) {
    sensed = false;
    unseen = Reason::kLinkLost;
    jaw.sense(in.jaw);
    const int n = arm.chain().dof();
    if (!in.state_valid) {
      if (enabled()) fault(Reason::kLinkLost);
      return;
    }
    const bool sized = in.q.size() == n && in.qd.size() == n;
    if (!sized || !in.q.allFinite() || !in.qd.allFinite()) {
      unseen = Reason::kStateNotFinite;
      if (operating.state() != State::kDisabled) fault(Reason::kStateNotFinite);
      return;
    }
    if (!(in.state_age <= robot.tuning.link_timeout)) {
      if (enabled()) fault(Reason::kLinkLost);
      return;
    }
    sensed = true;
    unseen = Reason::kNone;
    steady = trocar;
    if (!torn()) follow_trocar(in);
    arm.sense(in.q, in.qd, trocar);
    watch_tool(in);
  }

  void follow_trocar(const Inputs& in) {
    if (!track_rcm || !trocar.taught()) return;
    const Reason reason = trocar.track({in.track_valid, in.track_age, in.p_BTrack, in.v_BTrack}, T);
    untracked = reason;
    if (reason == Reason::kTrackStale) {
      pause(reason);
    } else if (reason != Reason::kNone && enabled()) {
      fault(reason);
    }
  }

  /// F31: without the tool link the arm holds, and so does the jaw.
  void watch_tool(const Inputs& in) {
    const bool lost = !(in.jaw_age <= kToolTimeout);
    if (lost && !tool_lost && enabled()) leave_enabled();
    tool_lost = lost;
    if (lost) out.reason = Reason::kToolLost;
  }

  // --- guard ----------------------------------------------------------------------------------

  /// F23: away from the trocar nothing may go on.
  void guard_pivot() {
    out.warn_rcm = trocar.taught() && shaft().e.norm() > limits.rcm_error_warn;
    if (!enabled() || !operating.homed() || !sensed) return;
    if (shaft().depth >= limits.depth_min) inserted = true;
    if (pilot.setpoint().axial() || pilot.retracing())
      inserted = false;  // on the way in or out through the trocar
    if (!on_line() || (inserted && shaft().depth <= 0)) {
      fault(Reason::kRcmError);
      trocar = steady;
      return;
    }
    // An arm that is stopped from elsewhere must not run after its set-point once it is released.
    const double behind = (X_BR * pilot.setpoint().p_RTip() - shaft().p_BTip).norm();
    if (!(behind <= kFollowDistance)) pause(Reason::kNotFollowing);
  }

  /// F25: yields to the force at the tip, stops or halts.
  void guard_force(const Inputs& in) {
    const ForceGuard::Verdict verdict = force.judge(in.tip_force, in.trocar_force, T);
    out.warn_force = force.warns();
    if (verdict == ForceGuard::Verdict::kHalt) freeze();  // a ramp that is under way ends as well
    if (!enabled()) return;
    switch (verdict) {
      case ForceGuard::Verdict::kFree:
      case ForceGuard::Verdict::kYield:
        break;
      case ForceGuard::Verdict::kPause:
        pause(Reason::kForce);
        break;
      case ForceGuard::Verdict::kStop:
        fault(Reason::kForce);
        break;
      case ForceGuard::Verdict::kHalt:
        fault(Reason::kForce);
        break;
    }
  }

  // --- gate -----------------------------------------------------------------------------------

  Reason take(const MotionCommand& command) {
    if (!enabled()) return Reason::kNotEnabled;
    if (command.motion == Motion::kHold) {  // obeyed from anyone
      pilot.hold();
      return Reason::kNone;
    }
    if (!operating.homed()) return Reason::kNotHomed;
    if (!authority.may_command(command.source)) return Reason::kNoAuthority;
    if (!finite(command)) {
      fault(Reason::kNotFinite);
      return Reason::kNotFinite;
    }
    if (tool_lost) return Reason::kToolLost;
    Reason reason = Reason::kNone;
    if (is_jaw(command.motion)) {
      jaw.go_to(command.jaw, command.motion == Motion::kJawMoveJp);
    } else {
      reason = pilot.take(command);
    }
    if (reason == Reason::kNone) authority.taken(command.source);
    return reason;
  }

  void gate(const Inputs& in) {
    const int n = std::clamp(in.n_commands, 0, kMaxCommands);
    for (int i = 0; i < n; ++i) {
      const MotionCommand& command = in.commands[i];
      const Reason reason = take(command);
      out.verdicts[i] = {reason, command.source, command.motion};
      ++(reason == Reason::kNone ? out.accepted : out.refused);
    }
    out.n_verdicts = n;
    const Reason watched = pilot.watch();
    if (watched != Reason::kNone) out.reason = watched;
  }

  // --- profiler, law, limits ------------------------------------------------------------------

  TwistWish wish_for(const Setpoint& next) const {
    const Setpoint& setpoint = pilot.setpoint();
    if (law == Law::kPaper) return paper_wish(arm, setpoint, next, X_BR, limits, T);
    return setpoint.axial() ? axial_wish(arm, setpoint, next, X_BR, trocar.v_B(), gains, T)
                            : velocity_wish(arm, setpoint, next, X_BR, trocar.v_B(), gains,
                                            force.push(), limits, T);
  }

  /// Where the set-point leads in t [s] of its own clock; the trocar is where it will be after this
  /// cycle.
  ShaftGoal goal_at(double t) const {
    Setpoint there = pilot.setpoint();
    there.advance(std::min(t, T));
    if (t > T) there = there.foreseen(t - T);
    const double arrives = T + (law == Law::kExact ? follower.delay() : 0.0);
    const Vector3 p_BRcm = trocar.p_B() + arrives * trocar.v_B() + pivot_offset;
    const Vector3 p_B = X_BR * there.p_RTip();
    if (!there.axial()) return tip_goal(p_BRcm, p_B, there.roll(), shaft().s);
    const Vector3 s_B = X_BR.linear() * there.s_R();
    return {p_BRcm, s_B, s_B.dot(p_B - p_BRcm), there.roll()};
  }

  /// What a stream will do is its sender's secret: a look ahead along a guess would slow it down
  /// for nothing. Barrier and braking distances guard it.
  double horizon() const {
    return pilot.setpoint().mode() == Setpoint::Mode::kStream ? 0.0 : kHorizon;
  }

  JointVector posture_at(const JointVector& q) const {
    return robot.tuning.posture_gain * (robot.home - q);
  }

  /// What the follower's correction takes of the flange's speed: the reference leaves it that room,
  /// as a command that is cut short would be off the pivot.
  double flange_lead() const {
    const Jacobian& J = arm.now().J;
    const double lead = (J * qd_last).head<3>().norm() - (J * follower.velocity()).head<3>().norm();
    return std::clamp(lead, 0.0, kMostLead * limits.flange_velocity);
  }

  /// Exact form: the reference's next step, and what makes the link follow it.
  Step exact_step(JointVector& qd) {
    // Critically damped: no jump in velocity at the start.
    const Vector3 pull = -kOntoPivot * (kOntoPivot * pivot_offset + 2 * pivot_offset_rate);
    pivot_offset_rate += T * pull;
    pivot_offset += T * pivot_offset_rate;
    const auto path = [this](double t) { return goal_at(t); };
    Wish wish;
    wish.path = PathView(path);
    wish.horizon = horizon();
    wish.v_BRcm = trocar.v_B() + pivot_offset_rate;
    wish.posture = posture_at(follower.reference());
    wish.flange_lead = flange_lead();
    const Home home{arm.s_home(), arm.R_home()};
    const Step step = limited.exact(follower.reference(), follower.velocity(), home, wish);
    qd = follower.advance(T * step.qd, arm.now().q, arm.now().J);
    return step;
  }

  /// Velocity form and the paper's law: from the measured state, where the command will find it.
  Step velocity_step(const Setpoint& next, JointVector& qd) const {
    const TwistWish wished = wish_for(next);
    const auto path = [this](double t) { return goal_at(t); };
    Wish wish;
    wish.feedback = wished.feedback;
    wish.forward = wished.path;
    wish.posture = posture_at(arm.now().q);
    if (law == Law::kVelocity && gains.rcm > 0) {  // an open loop is not where its path is
      wish.path = PathView(path);
      wish.horizon = horizon();
    }
    const Home home{arm.s_home(), arm.R_home()};
    const Step step = limited.velocity(arm.ahead().q, qd_last, home, trocar.p_B(), wish);
    qd = step.qd;
    return step;
  }

  /// The set-point goes on from where the tip will be: of the reference, or of the arm.
  void slip(const JointVector& qd) {
    Pose X_BF;
    Jacobian J;
    arm.chain().forward(
        law == Law::kExact ? follower.reference() : JointVector(arm.ahead().q + T * qd), X_BF, J);
    const Vector3 p_BTip = X_BF * arm.tool().p_FTip;
    const Vector6 twist = J * qd;
    const Vector3 v_BTip =
        twist.head<3>() + Vector3(twist.tail<3>()).cross(Vector3(p_BTip - X_BF.translation()));
    pilot.setpoint().slip(X_BR.inverse() * p_BTip, X_BR.linear().transpose() * v_BTip);
  }

  /// Back along the trace, once the motion before has come to rest; the set-point goes along.
  Step retrace_step(JointVector& qd) {
    // Joints are replayed, so a reference is followed whatever the law: the replay's way onto the
    // pivot takes one cycle, and from the state of an arm that answers late it would swing.
    if (!replaying && law != Law::kExact) follower.reset(arm.now().q, qd_last);
    replaying = true;
    const JointVector q = follower.reference();
    const Step step = limited.retrace(q, follower.velocity(), trace, back, kRetraceRate,
                                      trocar.p_B(), flange_lead());
    qd = follower.advance(T * step.qd, arm.now().q, arm.now().J);
    back += step.alpha * kRetraceRate * T;
    const Pose X_BF = arm.chain().forward(JointVector(q + T * step.qd));
    const Vector3 s_B = X_BF.linear() * arm.tool().s_F;
    const double turn = absolute_roll(X_BF.linear(), arm.R_home(), arm.s_home(), s_B);
    const double roll = pilot.setpoint().roll();
    pilot.setpoint().reset(X_BR.inverse() * (X_BF * arm.tool().p_FTip),
                           X_BR.linear().transpose() * s_B,
                           roll + std::remainder(turn - roll, 2 * M_PI));
    const bool arrived = back >= trace.length() && step.qd.cwiseAbs().maxCoeff() < kStill;
    if (trace.empty() || arrived) {
      if (back < kStill) out.reason = Reason::kNoTrace;
      pilot.end_retrace();
      trace.clear();
    }
    return step;
  }

  Step next_step(const Setpoint& next, JointVector& qd) {
    if (pilot.retracing() && pilot.setpoint().mode() == Setpoint::Mode::kRest) {
      return retrace_step(qd);
    }
    back = 0;
    replaying = false;
    if (enabled()) trace.record(law == Law::kExact ? follower.reference() : arm.now().q);
    return law == Law::kExact ? exact_step(qd) : velocity_step(next, qd);
  }

  void move() {
    const int n = arm.chain().dof();
    Setpoint& setpoint = pilot.setpoint();
    JointVector qd = JointVector::Zero(n);
    Vector6 twist = Vector6::Zero();
    out.scale = 1;
    out.limited_by = "";
    out.tier = 0;
    out.v_set.setZero();
    setpoint.elapse(T);
    if (!sensed || !trocar.taught() || !operating.homed()) {
      // Geometry unknown: a ramp through the law would be blind (F02, F10), and so would be going
      // on with one when the state comes back.
      freeze();
    } else if (!halted && (enabled() || ramping())) {
      setpoint.yield_to(X_BR.linear().transpose() * force.push());
      Setpoint next = setpoint;
      next.advance(T);
      const Step step = next_step(next, qd);
      twist = arm.ahead().J * qd;
      out.scale = step.alpha;
      out.limited_by = step.limited_by;
      out.tier = step.tier;
      if (step.held && enabled()) out.reason = Reason::kUnreachable;
      // The profile clock runs as fast as the arm may follow.
      const Vector3 p_before = setpoint.p_RTip();
      if (replaying) {
        // The set-point has gone along.
      } else if ((step.tier > 0 && setpoint.has_no_path()) ||
                 (step.alpha < 1 && setpoint.mode() == Setpoint::Mode::kStopping)) {
        setpoint = next;
        slip(step.qd);
      } else if (step.alpha < kStandstill) {
        setpoint.stand();
      } else if (step.alpha < 1) {
        setpoint.advance(step.alpha * T);
      } else {
        setpoint = next;
      }
      if (setpoint.at_wall() && step.alpha == 1) out.limited_by = "workspace";
      out.v_set = X_BR.linear() * (setpoint.p_RTip() - p_before) / T;
    } else if (!halted) {
      qd = fading_command();
      twist = arm.ahead().J * qd;
    }
    if (!qd.allFinite() || !twist.allFinite()) {  // the last statement before the wire
      fault(Reason::kNotFinite);
      freeze();
      qd.setZero();
      twist.setZero();
    }
    qd_last = qd;
    arm.remember(qd);
    out.qd_command = qd;
    out.twist_command = twist;
  }

  /// Halt: the set-point stands still at once, and the arm with it.
  void freeze() {
    halted = true;
    Setpoint& setpoint = pilot.setpoint();
    setpoint.reset(setpoint.p_RTip(), setpoint.s_R(), setpoint.roll());
  }

  // --- report ---------------------------------------------------------------------------------

  void report(const Inputs& in) {
    const Setpoint& setpoint = pilot.setpoint();
    const Reason arrival = pilot.follow_arrival(whereabouts());
    if (arrival != Reason::kNone) out.reason = arrival;
    out.state = operating.state();
    if (out.state != State::kEnabled) out.reason = operating.reason();
    out.homed = operating.homed();
    out.busy = pilot.busy() || jaw.busy() || home_busy > 0;
    home_busy = std::max(0, home_busy - 1);
    out.motion = pilot.motion();
    out.source = authority.holder();
    out.X_BF = arm.now().X_BF;
    out.p_BTip = shaft().p_BTip;
    out.s_B = shaft().s;
    out.p_BRcm = trocar.p_B();
    out.v_BTip = arm.v_BTip();
    out.roll = arm.now().roll;
    out.depth = shaft().depth;
    out.rcm_error = shaft().e.norm();
    out.p_goal = X_BR * pilot.p_goal();
    out.roll_goal = pilot.roll_goal();
    out.p_set = X_BR * setpoint.p_RTip();
    out.roll_set = setpoint.roll();
    out.jaw_set = jaw.setpoint();
    out.jaw = in.jaw;
    out.virtual_set = setpoint.joints();
    report_virtual_joints();
  }

  void report_virtual_joints() {
    const Matrix3 R_RB = X_BR.linear().transpose();
    const Vector3 s = R_RB * shaft().s, s_dot = R_RB * arm.s_dot();
    const Eigen::Vector2d angles = shaft_angles(s);
    const double cos_pitch = std::max(std::cos(angles[1]), 1e-6);
    out.virtual_q = {angles[0], angles[1], shaft().depth, arm.now().roll};
    const double insertion_rate = shaft().s.dot(Vector3(arm.v_BTip() - trocar.v_B())) +
                                  arm.s_dot().dot(Vector3(shaft().p_BTip - trocar.p_B()));
    const double roll_rate = sensed ? arm.roll_rate() : 0.0;
    out.virtual_qd = {(s_dot.x() * s.z() - s.x() * s_dot.z()) / (cos_pitch * cos_pitch),
                      s_dot.y() / cos_pitch, insertion_rate, roll_rate};
  }

  // --- image ----------------------------------------------------------------------------------

  /// Every member that a step reads before it writes it; a test finds the one that is missing.
  template <typename Image>
  void remembered(Image& image) {
    image(operating, authority, trocar, pilot, jaw, force);
    arm.remembered(image);
    follower.remembered(image);
    image(trace, back, replaying, pivot_offset, pivot_offset_rate, X_BR, sensed, unseen, untracked,
          inserted, tool_lost, halted, home_busy, qd_last, out.accepted, out.refused);
  }
};

Controller::Controller(const Chain& chain, const RobotConfig& robot, const Limits& limits,
                       const InstrumentConfig& instrument, const ToolCalibration& tool,
                       const Options& options)
    : impl_(std::make_unique<Impl>(chain, robot, limits, instrument, tool, options)) {}

Controller::~Controller() = default;

Reason Controller::request(StateCommand command) { return impl_->request(command); }

Reason Controller::set_rcm(const Vector3& p_BRcm) {
  Impl& self = *impl_;
  const State state = self.operating.state();
  if (state != State::kDisabled && state != State::kPaused) return Reason::kRcmWhileEnabled;
  if (!finite(p_BRcm)) return Reason::kNotFinite;
  self.trocar.teach(p_BRcm);
  self.X_BR.translation() = p_BRcm;
  self.operating.request(StateCommand::kUnhome, {});  // the rcm frame has changed
  if (self.sensed) self.arm.look_again(self.trocar);
  return Reason::kNone;
}

void Controller::fault(Reason reason) { impl_->fault(reason); }

void Controller::pause(Reason reason) { impl_->pause(reason); }

Reason Controller::claim(std::uint32_t source) {
  if (!impl_->authority.may_command(source)) return Reason::kNoAuthority;
  impl_->authority.claim(source);
  return Reason::kNone;
}

const Outputs& Controller::step(const Inputs& inputs) {
  Impl& self = *impl_;
  self.out.reason = Reason::kNone;
  self.sense(inputs);
  self.guard_pivot();
  self.guard_force(inputs);
  self.gate(inputs);
  self.move();
  self.jaw.advance(self.enabled() && !self.tool_lost);
  self.authority.elapse(self.pilot.setpoint().mode() == Setpoint::Mode::kRest, self.enabled());
  self.report(inputs);
  return self.out;
}

const Pose& Controller::X_BR() const { return impl_->X_BR; }

Eigen::Quaterniond Controller::tool_orientation(const Vector3& s_B, double roll) const {
  const Vector3 s_R = impl_->X_BR.linear().transpose() * s_B;
  return Eigen::Quaterniond(minimal_rotation(Vector3::UnitZ(), s_R) *
                            Eigen::AngleAxisd(roll, Vector3::UnitZ()));
}

bool Controller::rcm_set() const { return impl_->trocar.taught(); }
double Controller::dt() const { return impl_->T; }

std::size_t Controller::save(std::byte* to, std::size_t room) const {
  std::uint64_t layout = 0;
  const std::size_t head = sizeof layout;
  ImageWriter image(to, room, head);
  impl_->remembered(image);
  layout = image.layout();
  if (room >= head) std::memcpy(to, &layout, head);
  return image.size();
}

bool Controller::restore(const std::byte* from, std::size_t size) {
  std::uint64_t layout = 0;
  ImageWriter own(nullptr, 0, sizeof layout);
  impl_->remembered(own);
  if (size != own.size()) return false;
  std::memcpy(&layout, from, sizeof layout);
  if (layout != own.layout()) return false;
  ImageReader image(from + sizeof layout);
  impl_->remembered(image);
  return true;
}

}  // namespace surg
