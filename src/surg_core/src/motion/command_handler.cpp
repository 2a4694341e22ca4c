#include "surg_core/motion/command_handler.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "surg_core/law/rcm.hpp"
#include "surg_core/limits/stop_bound.hpp"
#include "surg_core/limits/workspace.hpp"
#include "surg_core/state/gate.hpp"

namespace surg {
namespace {

constexpr double kArrivedDistance = 5e-4;  // [m] from the target: a move has arrived
constexpr double kHeldWithin = 0.75;       // [s] near one place at a limit; then it is given up
constexpr double kHeldDistance = 1e-4;     // [m] of the set-point that is no progress
constexpr double kHeldRoll = 1e-3;         // [rad] of the set-point that is no progress
constexpr double kOldest = 0.2;            // [s] no sample waits longer for its cycle
constexpr double kAxialSpeed = 0.02;       // [m/s] of insert and withdraw
constexpr double kClearance = 0.01;        // [m] of the tip above the trocar after withdraw
constexpr double kMargin = 1e-3;           // [m] to a wall: slides inside; outside, is inserted
constexpr int kSlideTurns = 4;  // of the search for the tip's place at the end of the wrist

/// Angle of the twist about z in a rotation (swing-twist about the shaft at its target).
double twist_about_z(const Eigen::Quaterniond& q) { return 2 * std::atan2(q.z(), q.w()); }

/// Absolute roll of a tool orientation in R, of equal ones the nearest.
double roll_near(double near, const Vector3& p_RTip, const Eigen::Quaterniond& rotation) {
  const Matrix3 swing = minimal_rotation(Vector3::UnitZ(), p_RTip.normalized());
  const double requested = twist_about_z(Eigen::Quaterniond(Matrix3(swing.transpose())) * rotation);
  return near + wrapped(requested - near);
}

Vector3 tip_of(const Vector4& joints) { return joints[2] * shaft_direction(joints[0], joints[1]); }

/// 'shaft_direction' maps angles beyond a quarter turn to smaller ones, so they are refused here.
bool beyond_quarter_turn(const Vector4& joints) {
  return std::abs(joints[0]) > M_PI_2 || std::abs(joints[1]) > M_PI_2 || joints[2] < 0;
}

double stream_age(const MotionCommand& command) {
  return command.age >= 0 ? std::min(command.age, kOldest) : 0.0;
}

/// Velocity of the wrist centre [m/s] that moves the tip at v_tip although the joints turn
/// otherwise than wished: position first. The shaft turns with the centre about the trocar.
Vector3 centre_velocity(const WristGeometry& wrist, const WristPose& pose, const Vector3& v_tip,
                        double roll_rate, const WristJoints& joints) {
  const double depth = std::max(pose.centre.p.norm(), wrist.length());
  const Vector3 s = pose.centre.R.col(2);
  const FrameRate turning = tip_rate(wrist, pose, {Vector3::Zero(), roll_rate * s}, joints);
  Matrix3 J;
  for (int i = 0; i < 3; ++i) {
    const Vector3 v = Vector3::Unit(i);
    J.col(i) = tip_rate(wrist, pose, {v, s.cross(v) / depth}, WristJoints::Zero()).v;
  }
  return J.inverse() * (v_tip - turning.v);
}

std::array<double, 4> to_array(const Vector4& v) { return {v[0], v[1], v[2], v[3]}; }

}  // namespace

CommandHandler::CommandHandler(const Limits& limits, const Tuning& tuning,
                               const std::optional<WristConfig>& wrist, double dt, bool paper)
    : limits_(limits),
      tuning_(tuning),
      timeout_(tuning.servo_timeout),
      dt_(dt),
      setpoint_(limits, {tuning.profiler_duration, paper, tuning.stream_delay, tuning.tremor,
                         held_at_most(tuning, dt)}),
      wrist_(wrist, tuning) {}

void CommandHandler::start(const TipPose& at) {
  setpoint_.reset(at.p_RTip, at.s_R, at.roll);
  wrist_.start();
  set_goal(at.p_RTip, at.roll);
  joint_goal_ = setpoint_.joints();
  move_active_ = retracing_ = stream_blocked_ = sliding_ = newest_counts_ = false;
  motion_ = Motion::kNone;
}

void CommandHandler::stop() {
  setpoint_.stop();
  wrist_.stop();
  move_active_ = retracing_ = false;
}

void CommandHandler::set_fixtures(const Fixtures& fixtures_R) {
  fixtures_R_ = fixtures_R;
  if (!setpoint_.axial() && !setpoint_.way_is_clear(fixtures_R_)) stop();
}

bool CommandHandler::at_fixture() const {
  const Setpoint::Mode mode = setpoint_.mode();
  const bool moving = mode != Setpoint::Mode::kRest && mode != Setpoint::Mode::kProfile;
  return moving && setpoint_.at_fixture();
}

void CommandHandler::hold() {
  stop();
  stream_blocked_ = true;
  stream_silence_ = 0;
  motion_ = Motion::kHold;
}

void CommandHandler::set_goal(const Vector3& p_RTip, double roll) {
  p_goal_ = p_RTip;
  roll_goal_ = roll;
}

Motion CommandHandler::motion() const {
  const Setpoint::Mode mode = setpoint_.mode();
  const bool obeying =
      busy() || (mode != Setpoint::Mode::kRest && mode != Setpoint::Mode::kStopping);
  return obeying ? motion_ : Motion::kNone;
}

Reason CommandHandler::accept(const MotionCommand& command) {
  // A blocked stream is refused for that, whatever it says: only its silence ends the block.
  const bool blocked = stream_blocked_ && is_servo(command.motion);
  if (!wrist_.exists() || blocked) return take(command);
  MotionCommand resolved = command;
  const Reason reason = resolve_pose(resolved);
  if (reason != Reason::kNone) return reason;
  resolve_twist(resolved);
  const bool overtaken = setpoint_.mode() == Setpoint::Mode::kStream && motion_ == command.motion &&
                         setpoint_.overtaken(command.stamp_ns);
  const Reason answer = take(resolved);
  if (answer == Reason::kNone && !overtaken) move_wrist(resolved);
  return answer;
}

/// A pose of the tip becomes one of the wrist centre, with the joints of the wrist. With 'slide'
/// the wrist goes to the end of its range, and the tip keeps its place.
Reason CommandHandler::resolve_pose(MotionCommand& command) const {
  const bool stream = command.motion == Motion::kServoCp;
  const bool pose =
      stream || command.motion == Motion::kMoveCp || command.motion == Motion::kInterpolateCp;
  const bool joints = command.motion == Motion::kServoJp || command.motion == Motion::kMoveJp ||
                      command.motion == Motion::kInterpolateJp;
  const bool relative = command.motion == Motion::kServoJr || command.motion == Motion::kMoveJr;
  give_roll_to_drive(command);
  if (relative) command.wrist += present_wrist();
  if (joints || relative) {
    return wrist_.reaches(command.wrist) ? Reason::kNone : Reason::kOutsideWorkspace;
  }
  if (!pose) return Reason::kNone;
  TipFrame tip{command.p, command.rotation.toRotationMatrix()};
  WristPose wrist;
  for (int turn = 0; turn < kSlideTurns; ++turn) {
    const auto found = wrists_of_tip(wrist_.geometry(), tip);
    if (!found) return Reason::kOutsideWorkspace;
    wrist = (*found)[0];
    command.wrist << wrist.joints, drive_roll(wrist.centre);
    if (wrist_.reaches(command.wrist)) break;
    if (!(stream && command.slide)) return Reason::kOutsideWorkspace;
    const DriveJoints end = wrist_.nearest(command.wrist);
    wrist.joints = end.head<2>();
    wrist.centre.R =
        wrist.centre.R * Eigen::AngleAxisd(end[2] - command.wrist[2], Vector3::UnitZ());
    command.wrist = end;
    tip.R = tip_of_wrist(wrist_.geometry(), wrist).R;
  }
  command.p = wrist.centre.p;
  command.rotation = Eigen::Quaterniond(wrist.centre.R);
  return Reason::kNone;
}

/// A velocity of the tip becomes one of the wrist centre, of roll and wrist, at the set-point. Near
/// the end of a joint the tip keeps its own velocity, and its orientation gives way.
void CommandHandler::resolve_twist(MotionCommand& command) const {
  if (command.motion != Motion::kServoCv) return;
  const DriveJoints now = wrist_.set();
  const WristPose pose{
      {setpoint_.p_RTip(), shaft_rotation(setpoint_.s_R(), setpoint_.roll() + now[2])},
      now.head<2>()};
  const WristRate rate = wrist_rates(wrist_.geometry(), pose, {command.p, command.omega});
  command.roll_rate = wrist_.rolls() ? 0 : rate.roll_rate;
  command.wrist << rate.joints, wrist_.rolls() ? rate.roll_rate : 0;
  const DriveJoints turns = wrist_.allowed(command.wrist);
  command.p = centre_velocity(wrist_.geometry(), pose, command.p, command.roll_rate + turns[2],
                              turns.head<2>());
}

/// Where the drive rolls, it gets what joint commands ask of the roll beyond the arm's own.
void CommandHandler::give_roll_to_drive(MotionCommand& command) const {
  if (!wrist_.rolls()) return;
  const bool absolute = command.motion == Motion::kServoJp || command.motion == Motion::kMoveJp ||
                        command.motion == Motion::kInterpolateJp;
  const double arm = absolute ? setpoint_.roll() : 0;
  command.wrist[2] = command.joints[3] - arm;
  command.joints[3] = arm;
}

void CommandHandler::move_wrist(const MotionCommand& command) {
  const Motion motion = command.motion;
  if (motion == Motion::kServoCv || motion == Motion::kServoJv) {
    wrist_.set_velocity(command.wrist);
  } else if (is_servo(motion)) {
    wrist_.stream(command.wrist, stream_age(command), command.stamp_ns);
  } else if (has_target(motion)) {
    wrist_.move_to(command.wrist);
  }
}

Reason CommandHandler::take(const MotionCommand& command) {
  const Motion motion = command.motion;
  if (stream_blocked_ && is_servo(motion)) {  // a stream must not override a hold
    stream_silence_ = 0;
    return Reason::kHeld;
  }
  const bool along_shaft = motion == Motion::kInsert || motion == Motion::kWithdraw;
  const bool out = setpoint_.joints()[2] < limits_.depth_min - kMargin;
  if (out && !along_shaft && motion != Motion::kRetrace) return Reason::kNotInserted;
  const Reason reason = along_shaft ? move_along_shaft(motion) : apply(command);
  if (reason == Reason::kStreamStartTooFar) {
    // A stream that starts elsewhere must pause first. Otherwise it could start later, where its
    // path happens to come near the arm (F03).
    stream_blocked_ = true;
    stream_silence_ = 0;
  }
  if (reason != Reason::kNone) return reason;
  stream_blocked_ = false;
  retracing_ = motion == Motion::kRetrace;
  move_active_ = along_shaft || motion == Motion::kMoveCp || motion == Motion::kMoveJp ||
                 motion == Motion::kMoveJr;
  motion_ = motion;
  settle_time_ = held_ = 0;
  silent_cycles_ = 0;
  return Reason::kNone;
}

Reason CommandHandler::apply(const MotionCommand& command) {
  Vector4 joints = command.joints;
  switch (command.motion) {
    case Motion::kServoCp:
    case Motion::kServoJp:
    case Motion::kServoJr:
      return stream(command);
    case Motion::kServoCv:
      setpoint_.set_velocity(Space::kCartesian,
                             {command.p.x(), command.p.y(), command.p.z(), command.roll_rate});
      return Reason::kNone;
    case Motion::kServoJv:
      setpoint_.set_velocity(Space::kSpherical, to_array(joints));
      return Reason::kNone;
    case Motion::kInterpolateCp:
    case Motion::kMoveCp: {
      if (!targets_reachable(command.p)) return Reason::kOutsideWorkspace;
      const double roll = requested_roll(command.p, command.rotation);
      if (!roll_reachable(roll)) return Reason::kOutsideWorkspace;
      const Reason reason =
          move_to(Space::kCartesian, {command.p.x(), command.p.y(), command.p.z(), roll});
      if (reason != Reason::kNone) return reason;
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
      if (beyond_quarter_turn(joints) || !targets_reachable(p)) return Reason::kOutsideWorkspace;
      if (!roll_reachable(joints[3])) return Reason::kOutsideWorkspace;
      const Reason reason = move_to(Space::kSpherical, to_array(joints));
      if (reason != Reason::kNone) return reason;
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

Reason CommandHandler::move_to(Space space, const std::array<double, 4>& target) {
  if (setpoint_.move_to(space, target, fixtures_R_)) return Reason::kNone;
  Setpoint without = setpoint_;
  const bool only_fixtures = !fixtures_R_.empty() && without.move_to(space, target);
  return only_fixtures ? Reason::kFixture : Reason::kOutsideWorkspace;
}

/// insert, withdraw: straight along the shaft line, from rest. The way out is never blocked by a
/// fixture.
Reason CommandHandler::move_along_shaft(Motion motion) {
  if (setpoint_.mode() != Setpoint::Mode::kRest) return Reason::kRefusedTransition;
  const Vector3 s = setpoint_.s_R();
  const double depth = motion == Motion::kInsert ? limits_.depth_slow : -kClearance;
  const double now = s.dot(setpoint_.p_RTip());
  // A move of zero length if the tip is already there, so that a client sees it begin and end.
  const bool already_there = motion == Motion::kInsert ? now > depth : now < depth;
  Setpoint moved = setpoint_;
  moved.move_along(s, already_there ? now : depth, kAxialSpeed);
  if (motion == Motion::kInsert && !moved.way_is_clear(fixtures_R_)) return Reason::kFixture;
  setpoint_ = moved;
  set_goal(s * (already_there ? now : depth), setpoint_.roll());
  return Reason::kNone;
}

/// Inside the workspace, and near the trocar (F24) straight along the shaft only.
bool CommandHandler::targets_reachable(const Vector3& p_RTip) const {
  return inside_workspace(limits_, p_RTip) &&
         !aside_near_trocar(p_RTip, setpoint_.s_R(), limits_.depth_slow);
}

/// Inside the range, or no farther outside than the set-point is.
bool CommandHandler::roll_reachable(double roll) const {
  return std::abs(roll) <= std::max(limits_.roll_max, std::abs(setpoint_.roll()));
}

/// Absolute roll of the arm that a tool orientation in R asks for, continued from the present roll.
double CommandHandler::requested_roll(const Vector3& p_RTip,
                                      const Eigen::Quaterniond& rotation) const {
  if (wrist_.rolls()) return setpoint_.roll();
  return roll_near(setpoint_.mode() == Setpoint::Mode::kStream ? roll_goal_ : setpoint_.roll(),
                   p_RTip, rotation);
}

/// What the drive adds to the arm's roll, continued from what it was given.
double CommandHandler::drive_roll(const TipFrame& centre) const {
  if (!wrist_.rolls()) return 0;
  const double arm = setpoint_.roll();
  const bool streams = setpoint_.mode() == Setpoint::Mode::kStream;
  const double near = arm + (streams ? wrist_.goal() : wrist_.set())[2];
  return roll_near(near, centre.p, Eigen::Quaterniond(centre.R)) - arm;
}

/// The same of the wrist.
DriveJoints CommandHandler::present_wrist() const {
  const Setpoint::Mode mode = setpoint_.mode();
  const bool free = mode == Setpoint::Mode::kVelocity || mode == Setpoint::Mode::kStopping;
  return free || wrist_.at_rest() ? wrist_.set() : wrist_.goal();
}

/// Reference of relative commands: the goal of a joint motion in progress, else the set-point.
Vector4 CommandHandler::present_goal() const {
  const bool in_joints = motion_ == Motion::kServoJp || motion_ == Motion::kServoJr ||
                         motion_ == Motion::kMoveJp || motion_ == Motion::kMoveJr ||
                         motion_ == Motion::kInterpolateJp;
  const Setpoint::Mode mode = setpoint_.mode();
  const bool under_way = mode == Setpoint::Mode::kStream || mode == Setpoint::Mode::kProfile;
  return in_joints && under_way ? joint_goal_ : setpoint_.joints();
}

Reason CommandHandler::stream(const MotionCommand& command) {
  const bool cartesian = command.motion == Motion::kServoCp;
  Vector4 joints = command.joints;
  if (command.motion == Motion::kServoJr) joints += present_goal();
  const Vector3 hand = cartesian ? command.p : tip_of(joints);
  const bool slides = command.slide && cartesian && !targets_reachable(hand);
  const Vector3 p = slides ? nearest_reachable(hand) : hand;
  if ((!cartesian && beyond_quarter_turn(joints)) || !targets_reachable(p))
    return Reason::kOutsideWorkspace;
  const double roll = cartesian ? requested_roll(p, command.rotation) : joints[3];
  if (!roll_reachable(roll)) return Reason::kOutsideWorkspace;
  const bool begins = setpoint_.mode() != Setpoint::Mode::kStream || motion_ != command.motion;
  if (begins) {
    anchor_ = {setpoint_.p_RTip(), setpoint_.roll(), wrist_.set()};
    since_anchor_ = 0;
  }
  const double moved = ((begins ? p : hand) - anchor_.p).norm();
  // A sample that others have overtaken on their way says where the hand was before.
  if (!begins && setpoint_.overtaken(command.stamp_ns)) return Reason::kNone;
  Reason reason = check_step(limits_, begins, since_anchor_, moved, roll - anchor_.roll);
  if (reason == Reason::kNone && wrist_.exists()) {
    const double turned = (command.wrist - anchor_.wrist).cwiseAbs().maxCoeff();
    reason = check_wrist_step(limits_, wrist_.config(), begins, since_anchor_, turned);
  }
  if (reason != Reason::kNone) return reason;
  const bool walled = !fixtures_R_.empty();
  set_goal(walled ? setpoint_.slide(fixtures_R_).target({p, Vector3::Zero()}).p : p, roll);
  joint_goal_ = joints;
  newest_ = {hand, roll, command.wrist};
  newest_counts_ = true;
  sliding_ = slides;
  Vector4 target = joints;
  if (cartesian) target << p, roll;
  setpoint_.add_stream_sample(cartesian ? Space::kCartesian : Space::kSpherical, to_array(target),
                              stream_age(command), command.stamp_ns);
  return Reason::kNone;
}

/// The reachable target nearest to p, a little inside the workspace.
Vector3 CommandHandler::nearest_reachable(const Vector3& p_RTip) const {
  const Vector3 p = nearest_inside(limits_, p_RTip, kMargin);
  return targets_reachable(p) ? p : Vector3(p.normalized() * limits_.depth_slow);
}

Reason CommandHandler::check_timeout() {
  const bool streaming =
      setpoint_.mode() == Setpoint::Mode::kStream || setpoint_.mode() == Setpoint::Mode::kVelocity;
  // Counted in cycles, so that the deadline is exact: with 0.1 s and 2 ms the 51st cycle stops.
  const bool stale = streaming && silent_cycles_ > std::lround(timeout_ / dt_);
  if (stale) {
    setpoint_.stop();
    wrist_.stop();
  }
  ++silent_cycles_;
  // All samples of one cycle share the time since the last earlier one: what a sender may move
  // depends on time, not on its number of messages.
  if (newest_counts_) {
    anchor_ = newest_;
    since_anchor_ = 0;
    newest_counts_ = false;
  }
  since_anchor_ += dt_;
  stream_silence_ += dt_;
  if (stream_silence_ > timeout_) stream_blocked_ = false;
  return stale ? Reason::kStale : Reason::kNone;
}

Reason CommandHandler::check_arrival(const TipPose& at) {
  if (!move_active_ || setpoint_.mode() != Setpoint::Mode::kRest) return Reason::kNone;
  if (wrist_.exists() && !wrist_.at_rest()) return Reason::kNone;
  settle_time_ += dt_;
  const bool arrived = (setpoint_.p_RTip() - at.p_RTip).norm() < kArrivedDistance &&
                       (p_goal_ - setpoint_.p_RTip()).norm() < kArrivedDistance &&
                       std::abs(setpoint_.roll() - at.roll) < kArrivedDistance / kRollLever;
  if (arrived) {
    move_active_ = false;
  } else if (settle_time_ > kArriveWithin) {
    move_active_ = false;
    return Reason::kNotArrived;
  }
  return Reason::kNone;
}

Reason CommandHandler::check_progress(bool limited) {
  const bool driven = retracing_ || setpoint_.mode() == Setpoint::Mode::kProfile;
  const bool moved = (setpoint_.p_RTip() - p_held_).norm() > kHeldDistance ||
                     std::abs(setpoint_.roll() - roll_held_) > kHeldRoll;
  if (!driven || moved) {
    p_held_ = setpoint_.p_RTip();
    roll_held_ = setpoint_.roll();
    held_ = 0;
  }
  held_ += dt_;
  // A slow profile that nothing limits goes on.
  if (!driven || !limited || held_ <= kHeldWithin) return Reason::kNone;
  stop();
  return Reason::kNotArrived;
}

}  // namespace surg
