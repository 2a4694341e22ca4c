#include "surg_core/controller.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/gate.hpp"
#include "surg_core/image.hpp"
#include "surg_core/limits.hpp"
#include "surg_core/setpoint.hpp"

namespace surg {
namespace {

constexpr double kArrivedDistance = 5e-4;  // [m]
constexpr double kArrivedRoll = 0.01;      // [rad]
constexpr double kArriveWithin = 1.0;      // [s] after the profile's end; then the move ends anyway
constexpr double kFollowDistance = 0.01;   // [m] set-point to measured tip: more means a stuck arm
constexpr double kStandstill = 0.05;       // alpha below it: the limit has stopped the arm
constexpr double kAsideDistance = 0.002;   // [m] near the trocar only axial targets are taken
constexpr int kHomeBusyCycles = 5;         // is_busy needs an edge that a client can see

double wrapped(double angle) { return std::remainder(angle, 2 * M_PI); }

/// Angle of the twist about z in a rotation (swing-twist about the shaft at its target).
double twist_about_z(const Eigen::Quaterniond& q) { return 2 * std::atan2(q.z(), q.w()); }

}  // namespace

template <>
struct IsPlain<Setpoint> : std::true_type {};
template <>
struct IsPlain<ShaftState> : std::true_type {};

struct Controller::Impl {
  // Frozen.
  Chain chain;
  RobotConfig robot;
  Limits limits;
  InstrumentConfig instrument;
  Tool tool;
  Law law;
  double T, rcm_gain, tip_gain, roll_gain;

  // State machine and geometry.
  OperatingState operating;
  Authority authority;
  bool rcm_set = false;
  Vector3 p_BRcm = Vector3::Zero();
  Pose X_BR = Pose::Identity();
  Matrix3 R_home = Matrix3::Identity();
  Vector3 s_home = Vector3::UnitZ();
  bool sensed = false;  // a finite, fresh joint state has been seen in the last step
  Pose X_BF = Pose::Identity();
  Jacobian J;
  ShaftState shaft{};  // measured: what is judged and reported
  ShaftState ahead{};  // where this cycle's command will find the arm
  double roll_ahead = 0;
  JointVector in_flight;  // [rad] commanded but not yet measured
  Vector3 v_BTip = Vector3::Zero(), s_dot_B = Vector3::Zero();
  double omega_along_shaft = 0;
  double roll = 0;

  // What moves.
  Setpoint setpoint;
  Vector3 p_goal = Vector3::Zero();  // in R
  double roll_goal = 0;
  double since_pose = 0;  // [s] since the last accepted stream pose
  int silent_cycles = 0;  // since the last accepted servo command
  Motion motion = Motion::kNone;
  bool moving_to = false;     // a move_cp is on its way
  bool held = false;          // 'hold' was taken: a stream must pause before it goes on
  double stream_silence = 0;  // [s] since 'hold', or since a servo command was refused for it
  double settle = 0;          // [s] since its profile ended
  int home_busy = 0;
  double jaw_set = std::nan("");  // unknown until it has been measured (F31)
  double jaw_goal = 0;
  bool jaw_known = false;
  JointVector qd_last;
  Outputs out;

  Impl(const Chain& chain_in, const RobotConfig& robot_in, const Limits& limits_in,
       const InstrumentConfig& instrument_in, const ToolCalibration& calibration,
       const Options& options)
      : chain(chain_in),
        robot(robot_in),
        limits(limits_in),
        instrument(instrument_in),
        tool{calibration.s_F, calibration.p_FTip},
        law(options.law),
        T(options.dt),
        rcm_gain(options.feedback_gain >= 0 ? options.feedback_gain : robot_in.tuning.rcm_gain),
        tip_gain(robot_in.tuning.tip_gain),
        roll_gain(robot_in.tuning.roll_gain),
        authority(options.dt),
        in_flight(JointVector::Zero(chain_in.dof())),
        setpoint(limits_in, robot_in.tuning.profiler_duration, options.law == Law::kPaper),
        qd_last(JointVector::Zero(chain_in.dof())) {
    J.resize(6, chain.dof());
    out.qd_command = JointVector::Zero(chain.dof());
  }

  bool enabled() const { return operating.state() == State::kEnabled; }

  Conditions conditions() const { return {sensed, rcm_set, rcm_set && on_pivot()}; }

  /// The trocar point lies on the shaft, between flange and tip.
  bool on_pivot() const {
    return shaft.e.norm() <= limits.rcm_error_fault && shaft.depth > 0 &&
           shaft.depth < tool.s_F.dot(tool.p_FTip);
  }

  // --- state ----------------------------------------------------------------------------------

  Reason request(StateCommand command) {
    const State before = operating.state();
    // Clients home as a habit: on a homed arm that may be moving it changes nothing.
    const bool keep_home =
        command == StateCommand::kHome && operating.homed() && before == State::kEnabled;
    const Reason reason = operating.request(command, conditions());
    if (reason != Reason::kNone) return reason;
    if (command == StateCommand::kHome) {
      home_busy = kHomeBusyCycles;
      if (!keep_home) take_home();
    }
    if (before == State::kEnabled && !enabled()) leave_enabled();
    if (before != State::kEnabled && enabled()) start_here();
    return Reason::kNone;
  }

  void take_home() {
    s_home = shaft.s;
    R_home = X_BF.linear();
    X_BR = rcm_frame(s_home, p_BRcm);
    roll = 0;
    start_here();
  }

  /// The set-point is where the arm is; every target is gone.
  void start_here() {
    const Vector3 p_RTip = X_BR.inverse() * shaft.p_BTip;
    setpoint.reset(p_RTip, roll);
    p_goal = p_RTip;
    roll_goal = roll;
    moving_to = false;
    held = false;
    motion = Motion::kNone;
  }

  void leave_enabled() {
    setpoint.stop();
    jaw_goal = jaw_set;
    moving_to = false;
  }

  void fault(Reason reason) {
    operating.fault(reason);
    leave_enabled();
  }

  // --- sense ----------------------------------------------------------------------------------

  void sense(const Inputs& in) {
    sensed = false;
    const int n = chain.dof();
    if (!in.state_valid) {
      if (enabled()) fault(Reason::kLinkLost);
      return;
    }
    const bool sized = in.q.size() == n && in.qd.size() == n;
    if (!sized || !in.q.allFinite() || !in.qd.allFinite()) {
      if (operating.state() != State::kDisabled) fault(Reason::kStateNotFinite);
      return;
    }
    if (!(in.state_age <= robot.tuning.link_timeout)) {
      if (enabled()) fault(Reason::kLinkLost);
      return;
    }
    sensed = true;
    chain.forward(in.q, X_BF, J);
    shaft = shaft_state(X_BF, tool, p_BRcm);
    const Vector6 twist = J * in.qd;
    const Vector3 omega = twist.tail<3>();
    v_BTip = twist.head<3>() + omega.cross(Vector3(shaft.p_BTip - shaft.p_BF));
    s_dot_B = omega.cross(shaft.s);
    omega_along_shaft = omega.dot(shaft.s);
    if (operating.homed()) {
      const double now = absolute_roll(X_BF.linear(), R_home, s_home, shaft.s);
      roll += wrapped(now - roll);
    }
    look_ahead(in);
    if (!jaw_known && std::isfinite(in.jaw)) {
      jaw_set = jaw_goal = std::clamp(in.jaw, instrument.jaw_min, instrument.jaw_max);
      jaw_known = true;
    }
  }

  /// The law acts where its command will take effect, not where the arm was when it was measured.
  /// Without this a lag of 12 ms costs 8 % overshoot of the tip at 2 Hz and most of the pivot's
  /// deviation.
  void look_ahead(const Inputs& in) {
    ahead = shaft;
    roll_ahead = roll;
    if (law == Law::kPaper || rcm_gain == 0 || robot.tuning.link_lag <= 0) return;
    Pose X_ahead;
    chain.forward(JointVector(in.q + in_flight), X_ahead, J);
    ahead = shaft_state(X_ahead, tool, p_BRcm);
    if (!operating.homed()) return;
    const double soon = absolute_roll(X_ahead.linear(), R_home, s_home, ahead.s);
    roll_ahead = roll + wrapped(soon - roll);
  }

  /// First-order model of the link: what was commanded arrives with time constant link_lag.
  void remember(const JointVector& qd) {
    const double lag = robot.tuning.link_lag;
    if (lag <= 0) return;
    const double keep = std::exp(-T / lag);
    in_flight = keep * in_flight + lag * (1 - keep) * qd;
  }

  // --- gate -----------------------------------------------------------------------------------

  Reason take(const MotionCommand& command) {
    if (!enabled()) return Reason::kNotEnabled;
    if (command.motion == Motion::kHold) {  // obeyed from anyone
      setpoint.stop();
      moving_to = false;
      held = true;
      stream_silence = 0;
      motion = Motion::kHold;
      return Reason::kNone;
    }
    if (!operating.homed()) return Reason::kNotHomed;
    if (!authority.may_command(command.source)) return Reason::kNoAuthority;
    if (!finite(command)) {
      fault(Reason::kNotFinite);
      return Reason::kNotFinite;
    }
    if (command.motion == Motion::kJawServoJp) {
      jaw_goal = std::clamp(command.jaw, instrument.jaw_min, instrument.jaw_max);
      authority.taken(command.source);
      return Reason::kNone;
    }
    if (held && is_servo(command.motion)) {  // a stream must not talk over a hold
      stream_silence = 0;
      return Reason::kHeld;
    }
    const Reason reason = steer(command);
    if (reason != Reason::kNone) return reason;
    held = false;
    authority.taken(command.source);
    motion = command.motion;
    moving_to = command.motion == Motion::kMoveCp;
    settle = 0;
    silent_cycles = 0;
    return Reason::kNone;
  }

  static bool is_servo(Motion motion) {
    return motion == Motion::kServoCp || motion == Motion::kServoJp || motion == Motion::kServoCv ||
           motion == Motion::kServoJv;
  }

  static bool finite(const MotionCommand& command) {
    return command.p.allFinite() && command.rotation.coeffs().allFinite() &&
           command.joints.allFinite() && std::isfinite(command.roll_rate) &&
           std::isfinite(command.jaw);
  }

  /// Absolute roll that a tool orientation in R asks for, continued from the present roll.
  double asked_roll(const Vector3& p_RTip, const Eigen::Quaterniond& rotation) const {
    const Matrix3 swing = minimal_rotation(Vector3::UnitZ(), p_RTip.normalized());
    const double asked = twist_about_z(Eigen::Quaterniond(Matrix3(swing.transpose())) * rotation);
    const double near = setpoint.mode() == Setpoint::Mode::kStream ? roll_goal : setpoint.roll();
    return near + wrapped(asked - near);
  }

  Reason steer(const MotionCommand& command) {
    switch (command.motion) {
      case Motion::kServoCp:
      case Motion::kServoJp:
        return stream(command);
      case Motion::kServoCv:
        setpoint.drive(Space::kCartesian,
                       {command.p.x(), command.p.y(), command.p.z(), command.roll_rate});
        return Reason::kNone;
      case Motion::kServoJv:
        setpoint.drive(Space::kSpherical, {command.joints[0], command.joints[1], command.joints[2],
                                           command.joints[3]});
        return Reason::kNone;
      case Motion::kInterpolateCp:
      case Motion::kMoveCp: {
        if (!reachable(command.p)) return Reason::kOutsideWorkspace;
        p_goal = command.p;
        roll_goal = asked_roll(command.p, command.rotation);
        setpoint.go_to({p_goal.x(), p_goal.y(), p_goal.z(), roll_goal});
        return Reason::kNone;
      }
      case Motion::kNone:
      case Motion::kHold:
      case Motion::kJawServoJp:
      default:
        break;
    }
    return Reason::kNone;
  }

  /// Inside the workspace, and near the trocar (F24) straight along the shaft only.
  bool reachable(const Vector3& p_RTip) const {
    if (!inside_workspace(limits, p_RTip)) return false;
    const Vector3 s_R = setpoint.p_RTip().normalized();
    return p_RTip.norm() >= limits.depth_slow ||
           (p_RTip - s_R * s_R.dot(p_RTip)).norm() <= kAsideDistance;
  }

  Reason stream(const MotionCommand& command) {
    const bool spherical = command.motion == Motion::kServoJp;
    // Angles beyond a quarter turn fold back in 'shaft_direction': check them before they vanish in
    // it.
    const bool folded =
        spherical && (std::abs(command.joints[0]) > M_PI_2 ||
                      std::abs(command.joints[1]) > M_PI_2 || command.joints[2] < 0);
    const Vector3 p =
        spherical
            ? Vector3(command.joints[2] * shaft_direction(command.joints[0], command.joints[1]))
            : command.p;
    if (folded || !reachable(p)) return Reason::kOutsideWorkspace;
    const double asked = spherical ? command.joints[3] : asked_roll(p, command.rotation);
    const bool begins = setpoint.mode() != Setpoint::Mode::kStream || motion != command.motion;
    const Vector3 p_last = begins ? setpoint.p_RTip() : p_goal;
    const double roll_last = begins ? setpoint.roll() : roll_goal;
    const Reason reason =
        check_step(limits, begins, since_pose, (p - p_last).norm(), asked - roll_last);
    if (reason != Reason::kNone) return reason;
    p_goal = p;
    roll_goal = asked;
    since_pose = 0;
    if (spherical) {
      setpoint.follow(Space::kSpherical,
                      {command.joints[0], command.joints[1], command.joints[2], asked}, T);
    } else {
      setpoint.follow(Space::kCartesian, {p.x(), p.y(), p.z(), asked}, T);
    }
    return Reason::kNone;
  }

  void gate(const Inputs& in) {
    since_pose += T;
    ++silent_cycles;
    stream_silence += T;
    if (stream_silence > robot.tuning.servo_timeout) held = false;
    const int n = std::clamp(in.n_commands, 0, kMaxCommands);
    for (int i = 0; i < n; ++i) {
      const MotionCommand& command = in.commands[i];
      const Reason reason = take(command);
      out.verdicts[i] = {reason, command.source, command.motion};
      ++(reason == Reason::kNone ? out.accepted : out.refused);
    }
    out.n_verdicts = n;
    watch();
  }

  /// F03: a silent stream stops through the law; the arm stays ENABLED and holds.
  void watch() {
    const bool stream =
        setpoint.mode() == Setpoint::Mode::kStream || setpoint.mode() == Setpoint::Mode::kVelocity;
    // Counted in cycles, so that the deadline is exact: with 0.1 s and 2 ms the 51st cycle stops.
    if (stream && silent_cycles > std::lround(robot.tuning.servo_timeout / T)) {
      setpoint.stop();
      out.reason = Reason::kStale;
    }
  }

  // --- guard ----------------------------------------------------------------------------------

  /// F23: away from the trocar nothing may go on.
  void guard_pivot() {
    out.warn_rcm = rcm_set && shaft.e.norm() > limits.rcm_error_warn;
    if (!enabled() || !operating.homed() || !sensed) return;
    if (!on_pivot()) fault(Reason::kRcmError);
    // An arm that is stopped from elsewhere must not run after its set-point once it is released.
    const double behind = (X_BR * setpoint.p_RTip() - shaft.p_BTip).norm();
    if (enabled() && !(behind <= kFollowDistance)) {
      operating.pause(Reason::kNotFollowing);
      leave_enabled();
    }
  }

  // --- profiler, law, limits ------------------------------------------------------------------

  Vector6 twist_towards(const Setpoint& next) const {
    const Matrix3& R_BR = X_BR.linear();
    // Mean rates over the coming cycle, so that the tip arrives where the profile says.
    const Vector3 v_B = R_BR * (next.p_RTip() - setpoint.p_RTip()) / T;
    const double roll_rate = (next.roll() - setpoint.roll()) / T;
    if (law == Law::kPaper) return paper_twist(next, v_B, roll_rate);

    const bool hold =
        operating.state() != State::kEnabled && setpoint.mode() == Setpoint::Mode::kRest;
    if (hold) return Vector6::Zero();
    const Vector3 p_BSet = X_BR * setpoint.p_RTip();
    Vector3 v = v_B + tip_gain * (p_BSet - ahead.p_BTip);
    const double along = ahead.s.dot(v);
    v = along * ahead.s + lateral_fade(limits, ahead.depth) * (v - along * ahead.s);
    const Vector3 s_dot = (v - ahead.s * ahead.s.dot(v) - rcm_gain * ahead.e) /
                          std::max(ahead.depth, limits.depth_min);
    const double about = roll_rate + roll_gain * (setpoint.roll() - roll_ahead) +
                         roll_holonomy_rate(s_home, ahead.s, s_dot);
    return rcm_twist(ahead, v, about, Vector3::Zero(), rcm_gain, limits.depth_min);
  }

  /// The paper's equations as printed: open loop, rates straight from the profiler.
  Vector6 paper_twist(const Setpoint& next, const Vector3& v_B, double roll_rate) const {
    const Vector3 p_ee = X_BF.translation();
    if (next.space() == Space::kCartesian) {
      return paper_cartesian_twist(p_ee, shaft.p_BTip, p_BRcm, v_B, roll_rate);
    }
    // The printed law takes omega about base x and y and drops the third component, whatever the
    // trocar's attitude: the pivot rate that the profile asks for is handed to it in base axes.
    const Vector3 p_R = setpoint.p_RTip();
    const double depth = std::max(p_R.norm(), limits.depth_min);
    const Vector3 s_B = X_BR.linear() * p_R / depth;
    const Vector3 omega = s_B.cross(v_B) / depth;
    return paper_spherical_twist(p_ee, p_BRcm, omega.x(), omega.y(), roll_rate, s_B.dot(v_B));
  }

  void move(const Inputs& in) {
    const int n = chain.dof();
    JointVector qd = JointVector::Zero(n);
    Vector6 twist = Vector6::Zero();
    out.scale = 1;
    out.limited_by = "";
    out.v_set.setZero();
    setpoint.elapse(T);
    const bool halt = !sensed || !rcm_set || !operating.homed();
    if (!halt) {
      Setpoint next = setpoint;
      next.advance(T);
      twist = twist_towards(next);
      const JointVector posture = robot.tuning.posture_gain * (robot.home - in.q);
      const bool idle = twist.isZero(0);
      qd = idle ? JointVector::Zero(n) : inverse_velocity(J, twist, posture).qd;
      const Scale scale =
          uniform_scale(robot, limits, qd, qd_last, in.q, twist.head<3>().norm(), T);
      qd *= scale.alpha;
      twist *= scale.alpha;
      out.scale = scale.alpha;
      out.limited_by = scale.limited_by;
      // The profile clock runs as fast as the arm may follow.
      const Vector3 p_before = setpoint.p_RTip();
      if (scale.alpha < kStandstill) {
        setpoint.stand();
      } else if (scale.alpha < 1) {
        setpoint.advance(scale.alpha * T);
      } else {
        setpoint = next;
      }
      out.v_set = X_BR.linear() * (setpoint.p_RTip() - p_before) / T;
    } else if (setpoint.mode() != Setpoint::Mode::kRest) {
      // Geometry unknown: a ramp through the law would be blind (F02, F10).
      setpoint.reset(setpoint.p_RTip(), setpoint.roll());
    }
    if (!qd.allFinite() || !twist.allFinite()) {  // the last statement before the wire
      fault(Reason::kNotFinite);
      setpoint.reset(setpoint.p_RTip(), setpoint.roll());
      qd.setZero();
      twist.setZero();
    }
    qd_last = qd;
    remember(qd);
    out.qd_command = qd;
    out.twist_command = twist;
  }

  void move_jaw() {
    const double most = instrument.jaw_velocity * T;
    if (enabled() && jaw_known) jaw_set += std::clamp(jaw_goal - jaw_set, -most, most);
  }

  void follow_arrival() {
    if (!moving_to || setpoint.mode() != Setpoint::Mode::kRest) return;
    settle += T;
    const bool arrived = (X_BR * setpoint.p_RTip() - shaft.p_BTip).norm() < kArrivedDistance &&
                         std::abs(setpoint.roll() - roll) < kArrivedRoll;
    if (arrived || settle > kArriveWithin) moving_to = false;
  }

  // --- report ---------------------------------------------------------------------------------

  void report(const Inputs& in) {
    out.state = operating.state();
    if (out.state != State::kEnabled) out.reason = operating.reason();
    out.homed = operating.homed();
    out.busy = moving_to || home_busy > 0;
    home_busy = std::max(0, home_busy - 1);
    const bool obeying = moving_to || (setpoint.mode() != Setpoint::Mode::kRest &&
                                       setpoint.mode() != Setpoint::Mode::kStopping);
    out.motion = obeying ? motion : Motion::kNone;
    out.source = authority.holder();
    out.X_BF = X_BF;
    out.p_BTip = shaft.p_BTip;
    out.s_B = shaft.s;
    out.p_BRcm = p_BRcm;
    out.v_BTip = v_BTip;
    out.roll = roll;
    out.depth = shaft.depth;
    out.rcm_error = shaft.e.norm();
    out.p_goal = X_BR * p_goal;
    out.roll_goal = roll_goal;
    out.p_set = X_BR * setpoint.p_RTip();
    out.roll_set = setpoint.roll();
    out.jaw_set = jaw_set;
    out.jaw = in.jaw;
    report_virtual_joints();
  }

  void report_virtual_joints() {
    const Matrix3 R_RB = X_BR.linear().transpose();
    const Vector3 s = R_RB * shaft.s, s_dot = R_RB * s_dot_B;
    const Eigen::Vector2d angles = shaft_angles(s);
    const double cos_pitch = std::max(std::cos(angles[1]), 1e-6);
    out.virtual_q = {angles[0], angles[1], shaft.depth, roll};
    const double insertion_rate = shaft.s.dot(v_BTip) + s_dot_B.dot(Vector3(shaft.p_BTip - p_BRcm));
    // omega . s is roll plus the holonomy of the swing.
    const double roll_rate =
        sensed ? omega_along_shaft - roll_holonomy_rate(s_home, shaft.s, s_dot_B) : 0.0;
    out.virtual_qd = {(s_dot.x() * s.z() - s.x() * s_dot.z()) / (cos_pitch * cos_pitch),
                      s_dot.y() / cos_pitch, insertion_rate, roll_rate};
    const Vector3 p = setpoint.p_RTip();
    const double depth = std::max(p.norm(), 1e-6);
    const Eigen::Vector2d set = shaft_angles(p / depth);
    out.virtual_set = {set[0], set[1], p.norm(), setpoint.roll()};
  }

  // --- image ----------------------------------------------------------------------------------

  /// Every member that a step reads before it writes it; a test finds the one that is missing.
  template <typename Image>
  void remembered(Image& image) {
    image(operating, authority, rcm_set, p_BRcm, X_BR, R_home, s_home);
    image(sensed, X_BF, J, shaft, ahead, roll_ahead, in_flight);
    image(v_BTip, s_dot_B, omega_along_shaft, roll);
    image(setpoint, p_goal, roll_goal, since_pose, silent_cycles, motion, moving_to, held);
    image(stream_silence, settle, home_busy, jaw_set, jaw_goal, jaw_known, qd_last);
    image(out.accepted, out.refused, out.source);
  }
};

Controller::Controller(const Chain& chain, const RobotConfig& robot, const Limits& limits,
                       const InstrumentConfig& instrument, const ToolCalibration& tool,
                       const Options& options)
    : impl_(std::make_unique<Impl>(chain, robot, limits, instrument, tool, options)) {}

Controller::~Controller() = default;

Reason Controller::request(StateCommand command) { return impl_->request(command); }

Reason Controller::set_rcm(const Vector3& p_BRcm) {
  const State state = impl_->operating.state();
  if (state != State::kDisabled && state != State::kPaused) return Reason::kRcmWhileEnabled;
  if (!p_BRcm.allFinite()) return Reason::kNotFinite;
  impl_->p_BRcm = p_BRcm;
  impl_->rcm_set = true;
  impl_->X_BR.translation() = p_BRcm;
  impl_->operating.request(StateCommand::kUnhome, {});  // the rcm frame has changed
  if (impl_->sensed) impl_->shaft = shaft_state(impl_->X_BF, impl_->tool, p_BRcm);
  return Reason::kNone;
}

void Controller::fault(Reason reason) { impl_->fault(reason); }

void Controller::pause(Reason reason) {
  if (!impl_->enabled()) return;
  impl_->operating.pause(reason);
  impl_->leave_enabled();
}

const Outputs& Controller::step(const Inputs& inputs) {
  Impl& self = *impl_;
  self.out.reason = Reason::kNone;
  self.sense(inputs);
  self.guard_pivot();
  self.gate(inputs);
  self.move(inputs);
  self.move_jaw();
  self.follow_arrival();
  self.authority.elapse(self.setpoint.mode() == Setpoint::Mode::kRest, self.enabled());
  self.report(inputs);
  return self.out;
}

const Pose& Controller::X_BR() const { return impl_->X_BR; }

Eigen::Quaterniond Controller::tool_orientation(const Vector3& s_B, double roll) const {
  const Vector3 s_R = impl_->X_BR.linear().transpose() * s_B;
  return Eigen::Quaterniond(minimal_rotation(Vector3::UnitZ(), s_R) *
                            Eigen::AngleAxisd(roll, Vector3::UnitZ()));
}

Reason Controller::claim(std::uint32_t source) {
  if (!impl_->authority.may_command(source)) return Reason::kNoAuthority;
  impl_->authority.claim(source);
  return Reason::kNone;
}

bool Controller::rcm_set() const { return impl_->rcm_set; }
double Controller::dt() const { return impl_->T; }

std::size_t Controller::save(std::byte* to, std::size_t room) const {
  std::uint64_t layout = 0;
  const std::size_t head = sizeof layout;
  ImageWriter image(to + head, room > head ? room - head : 0);
  impl_->remembered(image);
  layout = image.layout();
  if (room >= head) std::memcpy(to, &layout, head);
  return head + image.size();
}

bool Controller::restore(const std::byte* from, std::size_t size) {
  std::uint64_t layout = 0;
  ImageWriter own(nullptr, 0);
  impl_->remembered(own);
  if (size != sizeof layout + own.size()) return false;
  std::memcpy(&layout, from, sizeof layout);
  if (layout != own.layout()) return false;
  ImageReader image(from + sizeof layout);
  impl_->remembered(image);
  return true;
}

}  // namespace surg
