#include "surg_core/controller.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "controller/controller_impl.hpp"

namespace surg {
namespace {

constexpr double kPositionReserve = 0.01;  // [rad] to position limits: a lagging joint overshoots

/// An open loop does not compensate the link's lag.
bool compensates_lag(const Controller::Options& options) {
  return options.law != Law::kPaper && options.feedback_gain != 0;
}

/// [s] of each joint, as stated.
JointVector stated_lag(const RobotConfig& robot) {
  const Eigen::Index n = robot.velocity.size();
  if (robot.joint_lag.size() == n) return robot.joint_lag;
  return JointVector::Constant(n, robot.tuning.link_lag);
}

/// [s] of each joint for the look-ahead, which only the velocity form needs.
JointVector look_ahead_lag(const RobotConfig& robot, const Controller::Options& options) {
  if (options.law != Law::kExact && compensates_lag(options)) return stated_lag(robot);
  return JointVector::Zero(robot.velocity.size());
}

/// Joint limits of the step. The virtual reference leaves a reserve for the follower.
JointLimits step_limits(const RobotConfig& robot, const Limits& limits, Law law) {
  JointLimits out = joint_limits(robot, limits);
  if (law == Law::kExact) {
    out.velocity *= ExactFollower::kReferenceShare;
    out.acceleration *= ExactFollower::kReferenceShare;
  }
  out.flange_velocity *= ExactFollower::kReferenceShare;
  out.position_min.array() += kPositionReserve;
  out.position_max.array() -= kPositionReserve;
  return out;
}

ExactFollower::Options follower_options(const RobotConfig& robot, const Limits& limits, double gain,
                                        bool compensates_lag, double T) {
  ExactFollower::Options out;
  if (compensates_lag) out.servo = stated_lag(robot);
  out.gain = gain;
  out.T = T;
  out.velocity = robot.velocity;
  out.acceleration = robot.acceleration;
  out.flange_velocity = limits.flange_velocity;
  return out;
}

StopRanges stop_ranges(const RobotConfig& robot) {
  const Tuning& tuning = robot.tuning;
  return {tuning.dead_man, tuning.stop_deceleration, tuning.braking_least * robot.acceleration,
          tuning.braking_most * robot.acceleration};
}

}  // namespace

Tool shaft_of(const InstrumentConfig& instrument, const ToolCalibration& tool) {
  const double wrist = instrument.wrist ? instrument.wrist->geometry.length() : 0.0;
  return {tool.s_F, tool.p_FTip - wrist * tool.s_F};
}

const Outputs& Controller::step(const Inputs& inputs) {
  Impl& self = *impl_;
  self.out.reason = Reason::kNone;
  self.out.elbow_limit = ElbowMotion::kNobody;
  self.clock.advance(inputs.elapsed);
  self.catch_up();
  self.sense(inputs);
  self.guard_robot(inputs);
  self.guard_lateness();
  self.guard_following();
  self.guard_pivot();
  self.guard_force(inputs);
  self.gate(inputs);
  self.advance();
  self.report(inputs);
  return self.out;
}

void Controller::Impl::advance() {
  if (clock.periods() == 0) {  // the last command stands
    if (!state_known) fade();
    return;
  }
  note(handler.check_timeout());
  move();
  jaw.advance(enabled() && !tool_lost, clock.periods());
  elapse_authority();
  note(handler.check_arrival(tip_pose()));
}

void Controller::Impl::note(Reason reason) {
  if (reason != Reason::kNone) out.reason = reason;
}

void Controller::Impl::elapse_authority() {
  const bool at_rest = handler.setpoint().mode() == Setpoint::Mode::kRest;
  authority.elapse(at_rest && !handler.busy() && !jaw.busy(), enabled());
}

Controller::Impl::Impl(const Chain& chain, const RobotConfig& robot_in, const Limits& limits_in,
                       const InstrumentConfig& instrument, const ToolCalibration& tool,
                       const Options& options, const ClearanceSetup& clearance_in)
    : robot(robot_in),
      limits(limits_in),
      law(options.law),
      track_rcm(options.track_rcm),
      passive(instrument.passive),
      T(options.dt),
      gains{options.feedback_gain >= 0 ? options.feedback_gain : robot_in.tuning.rcm_gain,
            robot_in.tuning.tip_gain, robot_in.tuning.roll_gain},
      clock(options.dt),
      commanded(robot_in.tuning.link_timeout, options.dt),
      authority(options.dt),
      trocar(
          {robot_in.tuning.track_noise, robot_in.tuning.track_jerk, robot_in.tuning.track_timeout}),
      arm(chain, shaft_of(instrument, tool), look_ahead_lag(robot_in, options), options.dt),
      handler(limits_in, robot_in.tuning, instrument.wrist, options.dt, options.law == Law::kPaper),
      jaw(instrument, options.dt),
      force(limits_in),
      limited(chain, shaft_of(instrument, tool), step_limits(robot_in, limits_in, options.law),
              options.dt),
      clearance(clearance_in, robot_in.tuning.link_lag, options.dt,
                held_at_most(robot_in.tuning, options.dt)),
      follower(chain.dof(), follower_options(robot_in, limits_in, gains.rcm,
                                             compensates_lag(options), options.dt)),
      lag_meter(stated_lag(robot_in)),
      elbow(chain, step_limits(robot_in, limits_in, options.law), robot_in.elbow, options.dt),
      stops(stop_ranges(robot_in), options.dt),
      standstill(robot_in.tuning.link_timeout),
      state_check(chain, robot_in.home, robot_in.acceleration),
      trocar_before(trocar),
      qd_last(JointVector::Zero(chain.dof())) {
  out.qd_command = qd_last;
  limited.keep_clear(clearance);
}

void Controller::Impl::report(const Inputs& in) {
  const Setpoint& setpoint = handler.setpoint();
  out.state = operating.state();
  if (out.state != State::kEnabled) out.reason = operating.reason();
  out.homed = operating.homed();
  out.busy = handler.busy() || jaw.busy() || elbow.busy() || home_busy > 0;
  home_busy = std::max(0, home_busy - 1);
  out.motion = handler.motion();
  out.source = authority.holder();
  out.X_BF = arm.measured().X_BF;
  out.p_BTip = shaft().p_BTip;
  out.s_B = shaft().s;
  out.p_BRcm = trocar.p_B();
  out.v_BTip = arm.v_BTip();
  out.roll = arm.measured().roll;
  out.depth = shaft().depth;
  out.rcm_error = shaft().e.norm();
  if (handler.sliding() && out.reason == Reason::kNone) out.reason = Reason::kOutsideWorkspace;
  out.elbow_goal = elbow.goal();
  if (enabled() && elbow.limited_by() != ElbowMotion::kNobody) {
    out.elbow_limit = elbow.limited_by();
    if (out.reason == Reason::kNone) out.reason = Reason::kElbowOutOfReach;
  }
  if (handler.at_fixture() && out.reason == Reason::kNone) out.reason = Reason::kFixture;
  out.p_goal = X_BR * handler.p_goal();
  out.roll_goal = handler.roll_goal();
  out.p_set = X_BR * setpoint.p_RTip();
  out.roll_set = setpoint.roll();
  out.jaw_set = jaw.setpoint();
  out.jaw = passive ? 0.0 : in.jaw;
  out.virtual_set = setpoint.joints();
  out.link_lag = lag_meter.lag();
  out.joint_lag = lag_meter.joint_lag();
  report_virtual_joints();
  if (handler.wrist().exists()) report_wrist(in);
  report_stop_bound(in);
}

void Controller::Impl::report_stop_bound(const Inputs& in) {
  out.stop_bound = {};
  if (!state_known) return;
  const Tool tool{arm.tool().s_F, out.X_BF.inverse() * out.p_BTip};
  const double lag = std::max(lag_meter.link().slowest(), robot.tuning.link_lag);
  out.stop_bound = stops.bound(arm.chain(), {q, qd, in.state_age, lag, tool, trocar.p_B()});
  if (!out.wrist.exists) return;
  // The wrist's own drive goes on to the newest angles that it was given.
  const DriveJoints left = (out.wrist.command - driven(in)).cwiseAbs();
  const WristGeometry& wrist = out.wrist.geometry;
  out.stop_bound.tip += (left[0] + left[2]) * wrist.length() + left[1] * wrist.yaw_to_tip;
}

TipFrame Controller::Impl::tip_behind_wrist(const Vector3& p_RCentre, const Vector3& s_R,
                                            double roll, const WristJoints& joints) const {
  return tip_of_wrist(handler.wrist().geometry(), {{p_RCentre, shaft_rotation(s_R, roll)}, joints});
}

DriveJoints Controller::Impl::driven(const Inputs& in) const {
  return in.wrist.allFinite() ? in.wrist : handler.wrist().set();
}

/// So far the report has the wrist centre where it says tip, and the arm's roll where it says roll.
void Controller::Impl::report_wrist(const Inputs& in) {
  const WristMotion& wrist = handler.wrist();
  const Setpoint& setpoint = handler.setpoint();
  const Matrix3 R_RB = X_BR.linear().transpose();
  const Vector3 s_R = R_RB * shaft().s, goal_R = handler.p_goal();
  WristOutputs& to = out.wrist;
  to.exists = true;
  to.geometry = wrist.geometry();
  const DriveJoints q = driven(in), set_to = wrist.set(), bound_for = wrist.goal();
  const DriveJoints qd = in.wrist_rate.allFinite() ? in.wrist_rate : DriveJoints::Zero().eval();
  to.q = q.head<2>();
  to.qd = qd.head<2>();
  to.set = set_to.head<2>();
  to.goal = bound_for.head<2>();
  out.roll += q[2];
  out.roll_set += set_to[2];
  out.roll_goal += bound_for[2];
  out.virtual_q[3] += q[2];
  out.virtual_qd[3] += qd[2];
  out.virtual_set[3] += set_to[2];
  to.command = wrist.command(law == Law::kExact ? follower.delay() : robot.tuning.link_lag);

  const Vector3 centre_R = X_BR.inverse() * shaft().p_BTip;
  const WristPose measured{{centre_R, shaft_rotation(s_R, out.roll)}, to.q};
  const Vector3 turning = s_R.cross(R_RB * arm.s_dot()) + out.virtual_qd[3] * s_R;
  const FrameRate rate =
      tip_rate(wrist.geometry(), measured, {R_RB * arm.v_BTip(), turning}, to.qd);
  const TipFrame tip = tip_of_wrist(wrist.geometry(), measured);
  const TipFrame set = tip_behind_wrist(setpoint.p_RTip(), setpoint.s_R(), out.roll_set, to.set);
  const double far = goal_R.norm();
  const TipFrame goal =
      tip_behind_wrist(goal_R, far > 1e-6 ? Vector3(goal_R / far) : s_R, out.roll_goal, to.goal);
  to.R_RTip = tip.R;
  to.R_RSet = set.R;
  to.R_RGoal = goal.R;
  to.omega_B = X_BR.linear() * rate.omega;
  out.p_BTip = X_BR * tip.p;
  out.v_BTip = X_BR.linear() * rate.v;
  out.p_set = X_BR * set.p;
  out.p_goal = X_BR * goal.p;
}

void Controller::Impl::report_virtual_joints() {
  const Matrix3 R_RB = X_BR.linear().transpose();
  const Vector3 s = R_RB * shaft().s, s_dot = R_RB * arm.s_dot();
  const Eigen::Vector2d angles = shaft_angles(s);
  const double cos_pitch = std::max(std::cos(angles[1]), 1e-6);
  out.virtual_q = {angles[0], angles[1], shaft().depth, arm.measured().roll};
  const double insertion_rate = shaft().s.dot(Vector3(arm.v_BTip() - trocar.v_B())) +
                                arm.s_dot().dot(Vector3(shaft().p_BTip - trocar.p_B()));
  const double roll_rate = state_known ? arm.roll_rate() : 0.0;
  out.virtual_qd = {(s_dot.x() * s.z() - s.x() * s_dot.z()) / (cos_pitch * cos_pitch),
                    s_dot.y() / cos_pitch, insertion_rate, roll_rate};
}

Controller::Controller(const Chain& chain, const RobotConfig& robot, const Limits& limits,
                       const InstrumentConfig& instrument, const ToolCalibration& tool,
                       const Options& options, const ClearanceSetup& clearance)
    : impl_(std::make_unique<Impl>(chain, robot, limits, instrument, tool, options, clearance)) {}

Controller::~Controller() = default;

Reason Controller::request(StateCommand command) { return impl_->request(command); }

Reason Controller::set_rcm(const Vector3& p_BRcm) { return impl_->set_rcm(p_BRcm); }

Reason Controller::set_fixture(const Fixture& fixture) { return impl_->set_fixture(fixture); }

Reason Controller::remove_fixture(std::string_view name) { return impl_->remove_fixture(name); }

const Fixtures& Controller::fixtures() const { return impl_->fixtures; }

Reason Controller::change_tool(const InstrumentConfig& instrument, const ToolCalibration& tool) {
  return impl_->change_tool(instrument, tool);
}

void Controller::fault(Reason reason) { impl_->fault(reason); }

void Controller::pause(Reason reason) { impl_->pause(reason); }

Reason Controller::claim(std::uint32_t source) {
  if (!impl_->authority.may_command(source)) return Reason::kNoAuthority;
  impl_->authority.claim(source);
  return Reason::kNone;
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
  SnapshotWriter archive(to, room, head);
  impl_->serialize(archive);
  layout = archive.layout();
  if (room >= head) std::memcpy(to, &layout, head);
  return archive.size();
}

bool Controller::restore(const std::byte* from, std::size_t size) {
  std::uint64_t layout = 0;
  SnapshotWriter own(nullptr, 0, sizeof layout);
  impl_->serialize(own);
  if (size != own.size()) return false;
  std::memcpy(&layout, from, sizeof layout);
  if (layout != own.layout()) return false;
  SnapshotReader archive(from + sizeof layout);
  impl_->serialize(archive);
  return true;
}

}  // namespace surg
