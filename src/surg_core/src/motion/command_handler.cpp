#include "surg_core/motion/command_handler.hpp"

#include <cmath>

#include "surg_core/law/rcm.hpp"
#include "surg_core/limits/workspace.hpp"
#include "surg_core/state/gate.hpp"

namespace surg {
namespace {

constexpr double kArrivedDistance = 5e-4;  // [m]
constexpr double kArrivedRoll = 0.01;      // [rad]
constexpr double kArriveWithin = 1.0;      // [s] after the profile's end; then the move is given up
constexpr double kAxialSpeed = 0.02;       // [m/s] of insert and withdraw
constexpr double kClearance = 0.01;        // [m] of the tip above the trocar after withdraw
constexpr double kNotInsertedSlack = 1e-3;  // [m] a tip that rests on depth_min is still inserted

/// Angle of the twist about z in a rotation (swing-twist about the shaft at its target).
double twist_about_z(const Eigen::Quaterniond& q) { return 2 * std::atan2(q.z(), q.w()); }

Vector3 tip_of(const Vector4& joints) { return joints[2] * shaft_direction(joints[0], joints[1]); }

/// Angles beyond a quarter turn fold back in 'shaft_direction': seen before they vanish in it.
bool folded(const Vector4& joints) {
  return std::abs(joints[0]) > M_PI_2 || std::abs(joints[1]) > M_PI_2 || joints[2] < 0;
}

std::array<double, 4> as_target(const Vector4& v) { return {v[0], v[1], v[2], v[3]}; }

}  // namespace

Pilot::Pilot(const Limits& limits, const Tuning& tuning, double dt, bool paper)
    : limits_(limits),
      timeout_(tuning.servo_timeout),
      dt_(dt),
      setpoint_(limits, tuning.profiler_duration, paper, tuning.stream_delay) {}

void Pilot::start(const Whereabouts& at) {
  setpoint_.reset(at.p_RTip, at.s_R, at.roll);
  set_goal(at.p_RTip, at.roll);
  joint_goal_ = setpoint_.joints();
  moving_to_ = retracing_ = held_ = false;
  motion_ = Motion::kNone;
}

void Pilot::stop() {
  setpoint_.stop();
  moving_to_ = retracing_ = false;
}

void Pilot::hold() {
  stop();
  held_ = true;
  stream_silence_ = 0;
  motion_ = Motion::kHold;
}

void Pilot::set_goal(const Vector3& p_RTip, double roll) {
  p_goal_ = p_RTip;
  roll_goal_ = roll;
}

Motion Pilot::motion() const {
  const Setpoint::Mode mode = setpoint_.mode();
  const bool obeying =
      busy() || (mode != Setpoint::Mode::kRest && mode != Setpoint::Mode::kStopping);
  return obeying ? motion_ : Motion::kNone;
}

Reason Pilot::take(const MotionCommand& command) {
  const Motion motion = command.motion;
  if (held_ && is_servo(motion)) {  // a stream must not talk over a hold
    stream_silence_ = 0;
    return Reason::kHeld;
  }
  const bool along = motion == Motion::kInsert || motion == Motion::kWithdraw;
  const bool out = setpoint_.joints()[2] < limits_.depth_min - kNotInsertedSlack;
  if (out && !along && motion != Motion::kRetrace) return Reason::kNotInserted;
  const Reason reason = along ? go_along(motion) : go(command);
  if (reason == Reason::kStreamStartTooFar) {
    // A stream that woke up elsewhere must end first: it may not be caught again where its path
    // happens to come near (F03).
    held_ = true;
    stream_silence_ = 0;
  }
  if (reason != Reason::kNone) return reason;
  held_ = false;
  retracing_ = motion == Motion::kRetrace;
  moving_to_ =
      along || motion == Motion::kMoveCp || motion == Motion::kMoveJp || motion == Motion::kMoveJr;
  motion_ = motion;
  settle_ = 0;
  silent_cycles_ = 0;
  return Reason::kNone;
}

Reason Pilot::go(const MotionCommand& command) {
  Vector4 joints = command.joints;
  switch (command.motion) {
    case Motion::kServoCp:
    case Motion::kServoJp:
    case Motion::kServoJr:
      return stream(command);
    case Motion::kServoCv:
      setpoint_.drive(Space::kCartesian,
                      {command.p.x(), command.p.y(), command.p.z(), command.roll_rate});
      return Reason::kNone;
    case Motion::kServoJv:
      setpoint_.drive(Space::kSpherical, as_target(joints));
      return Reason::kNone;
    case Motion::kInterpolateCp:
    case Motion::kMoveCp: {
      if (!targets_reachable(command.p)) return Reason::kOutsideWorkspace;
      const double roll = asked_roll(command.p, command.rotation);
      const bool inside =
          setpoint_.go_to(Space::kCartesian, {command.p.x(), command.p.y(), command.p.z(), roll});
      if (!inside) return Reason::kOutsideWorkspace;
      set_goal(command.p, roll);
      joint_goal_ = setpoint_.joints();
      return Reason::kNone;
    }
    case Motion::kMoveJr:
      joints += present_goal();
      [[fallthrough]];
    case Motion::kInterpolateJp:
    case Motion::kMoveJp: {
      const Vector3 p = tip_of(joints);
      if (folded(joints) || !targets_reachable(p)) return Reason::kOutsideWorkspace;
      if (!setpoint_.go_to(Space::kSpherical, as_target(joints))) return Reason::kOutsideWorkspace;
      set_goal(p, joints[3]);
      joint_goal_ = joints;
      return Reason::kNone;
    }
    case Motion::kRetrace:
      stop();
      return Reason::kNone;
    default:
      return Reason::kRefusedTransition;
  }
}

/// insert, withdraw: straight along the shaft line, from rest.
Reason Pilot::go_along(Motion motion) {
  if (setpoint_.mode() != Setpoint::Mode::kRest) return Reason::kRefusedTransition;
  const Vector3 s = setpoint_.s_R();
  const double depth = motion == Motion::kInsert ? limits_.depth_slow : -kClearance;
  const double now = s.dot(setpoint_.p_RTip());
  // Already there: a move of zero length, so that a client still sees it begin and end.
  const bool there = motion == Motion::kInsert ? now > depth : now < depth;
  setpoint_.go_along(s, there ? now : depth, kAxialSpeed);
  set_goal(s * (there ? now : depth), setpoint_.roll());
  return Reason::kNone;
}

/// Inside the workspace, and near the trocar (F24) straight along the shaft only.
bool Pilot::targets_reachable(const Vector3& p_RTip) const {
  return inside_workspace(limits_, p_RTip) &&
         !aside_near_trocar(p_RTip, setpoint_.s_R(), limits_.depth_slow);
}

/// Absolute roll that a tool orientation in R asks for, continued from the present roll.
double Pilot::asked_roll(const Vector3& p_RTip, const Eigen::Quaterniond& rotation) const {
  const Matrix3 swing = minimal_rotation(Vector3::UnitZ(), p_RTip.normalized());
  const double asked = twist_about_z(Eigen::Quaterniond(Matrix3(swing.transpose())) * rotation);
  const double near = setpoint_.mode() == Setpoint::Mode::kStream ? roll_goal_ : setpoint_.roll();
  return near + wrapped(asked - near);
}

/// What a relative command adds to: the goal of a motion under way in joints, else the set-point.
Vector4 Pilot::present_goal() const {
  const bool in_joints = motion_ == Motion::kServoJp || motion_ == Motion::kServoJr ||
                         motion_ == Motion::kMoveJp || motion_ == Motion::kMoveJr ||
                         motion_ == Motion::kInterpolateJp;
  const Setpoint::Mode mode = setpoint_.mode();
  const bool under_way = mode == Setpoint::Mode::kStream || mode == Setpoint::Mode::kProfile;
  return in_joints && under_way ? joint_goal_ : setpoint_.joints();
}

Reason Pilot::stream(const MotionCommand& command) {
  const bool cartesian = command.motion == Motion::kServoCp;
  Vector4 joints = command.joints;
  if (command.motion == Motion::kServoJr) joints += present_goal();
  const Vector3 p = cartesian ? command.p : tip_of(joints);
  if ((!cartesian && folded(joints)) || !targets_reachable(p)) return Reason::kOutsideWorkspace;
  const double asked = cartesian ? asked_roll(p, command.rotation) : joints[3];
  const bool begins = setpoint_.mode() != Setpoint::Mode::kStream || motion_ != command.motion;
  const Vector3 p_last = begins ? setpoint_.p_RTip() : p_goal_;
  const double roll_last = begins ? setpoint_.roll() : roll_goal_;
  const Reason reason =
      check_step(limits_, begins, since_pose_, (p - p_last).norm(), asked - roll_last);
  if (reason != Reason::kNone) return reason;
  set_goal(p, asked);
  joint_goal_ = joints;
  since_pose_ = 0;
  if (cartesian) {
    setpoint_.follow(Space::kCartesian, {p.x(), p.y(), p.z(), asked}, dt_);
  } else {
    setpoint_.follow(Space::kSpherical, as_target(joints), dt_);
  }
  return Reason::kNone;
}

Reason Pilot::watch() {
  const bool streaming =
      setpoint_.mode() == Setpoint::Mode::kStream || setpoint_.mode() == Setpoint::Mode::kVelocity;
  // Counted in cycles, so that the deadline is exact: with 0.1 s and 2 ms the 51st cycle stops.
  const bool stale = streaming && silent_cycles_ > std::lround(timeout_ / dt_);
  if (stale) setpoint_.stop();
  ++silent_cycles_;
  since_pose_ += dt_;
  stream_silence_ += dt_;
  if (stream_silence_ > timeout_) held_ = false;
  return stale ? Reason::kStale : Reason::kNone;
}

Reason Pilot::follow_arrival(const Whereabouts& at) {
  if (!moving_to_ || setpoint_.mode() != Setpoint::Mode::kRest) return Reason::kNone;
  settle_ += dt_;
  const bool arrived = (setpoint_.p_RTip() - at.p_RTip).norm() < kArrivedDistance &&
                       (p_goal_ - setpoint_.p_RTip()).norm() < kArrivedDistance &&
                       std::abs(setpoint_.roll() - at.roll) < kArrivedRoll;
  if (arrived) {
    moving_to_ = false;
  } else if (settle_ > kArriveWithin) {
    moving_to_ = false;
    return Reason::kNotArrived;
  }
  return Reason::kNone;
}

}  // namespace surg
