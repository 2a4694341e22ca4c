#include "surg_control/loop/control_cycle.hpp"

#include <algorithm>
#include <chrono>
#include <limits>

#include "surg_control/topics/virtual_kinematics.hpp"

namespace surg_control {
namespace {

constexpr double kTiltTolerance = 0.0175;     // [rad], 1 degree: smaller tilts are not reported
constexpr double kAngularTolerance = 0.0175;  // [rad/s]
constexpr std::int64_t kTrackAgeNs = 200'000'000;   // an older stamp belongs to another clock
constexpr std::int64_t kTrackHeldNs = 100'000'000;  // younger samples exclude other trackers

constexpr std::int64_t kForceLostNs = 200'000'000;  // F25: a sensor that has spoken must go on

/// The force of a silent sensor is unknown, not zero. A sensor that says that it does not know, or
/// has not spoken yet, is missed only where the cell requires it.
surg::ForceSample force_of(const MeasuredForce& measured, std::int64_t now_ns, bool required) {
  const bool spoken = measured.received_ns != 0;
  if (spoken && now_ns - measured.received_ns > kForceLostNs) {
    return {true, surg::Vector3::Constant(std::numeric_limits<double>::quiet_NaN())};
  }
  // Infinite: not known (RcmLoop::on_force). NaN is a broken sensor: the arm fades.
  if (spoken && !measured.f_B.array().isInf().any()) return {true, measured.f_B};
  if (!required) return {};
  return {false, surg::Vector3::Constant(std::numeric_limits<double>::infinity())};
}

double seconds(std::int64_t ns) { return static_cast<double>(ns) * 1e-9; }

/// [s] since something was received; infinite if it never was.
double age(std::int64_t received_ns, std::int64_t now_ns) {
  return received_ns == 0 ? std::numeric_limits<double>::infinity() : seconds(now_ns - received_ns);
}

bool is_home(const CommandItem& item) {
  return item.kind == CommandItem::Kind::kState && item.state == surg::StateCommand::kHome;
}

/// Whether a client waits for the command's end by is_busy.
bool is_waited_for(const CommandItem& item) {
  if (is_home(item)) return true;
  if (item.kind != CommandItem::Kind::kMotion) return false;
  switch (item.motion.motion) {
    case surg::Motion::kMoveCp:
    case surg::Motion::kMoveJp:
    case surg::Motion::kMoveJr:
    case surg::Motion::kJawMoveJp:
    case surg::Motion::kElbowMoveJp:
    case surg::Motion::kInsert:
    case surg::Motion::kWithdraw:
    case surg::Motion::kRetrace:
      return true;
    default:
      return false;
  }
}

bool is_pose(surg::Motion motion) {
  return motion == surg::Motion::kServoCp || motion == surg::Motion::kInterpolateCp ||
         motion == surg::Motion::kMoveCp;
}

}  // namespace

ControlCycle::ControlCycle(const surg::Controller& controller, surg::BlackBox& box,
                           std::string_view rcm_frame)
    : controller_(controller), box_(box), rcm_frame_(rcm_frame) {
  record_.frame.name = rcm_frame_;
  record_.fixtures = controller_.fixtures();
}

surg::Reason ControlCycle::answer(const CommandItem& item, std::int64_t now_ns) {
  switch (item.kind) {
    case CommandItem::Kind::kState:
      return request(item.state);
    case CommandItem::Kind::kTool:
      return change_tool(*item.tool);
    case CommandItem::Kind::kSetRcm:
      return box_.set_rcm(item.p_B);
    case CommandItem::Kind::kSetFixture:
      return box_.set_fixture(item.fixture);
    case CommandItem::Kind::kRemoveFixture:
      return box_.remove_fixture(item.fixture.title());
    case CommandItem::Kind::kSetFrame:
      return set_frame(item);
    case CommandItem::Kind::kClaim:
      return box_.claim(item.source);
    case CommandItem::Kind::kAtWall:
      return set_sliding(item.source, item.slide);
    case CommandItem::Kind::kTrack:
      return take_track(item, now_ns);
    case CommandItem::Kind::kMotion:
      return take_motion(item, now_ns);
  }
  return surg::Reason::kNone;
}

surg::Reason ControlCycle::request(surg::StateCommand command) {
  const surg::Reason reason = box_.request(command);
  if (reason != surg::Reason::kNone) return reason;
  if (command == surg::StateCommand::kEnable || command == surg::StateCommand::kResume) {
    enabled_ = true;
  } else if (command == surg::StateCommand::kDisable || command == surg::StateCommand::kPause) {
    enabled_ = false;
  } else {
    homed_ = command == surg::StateCommand::kHome;
  }
  return reason;
}

void ControlCycle::note_fixtures() {
  for (int i = 0; i < record_.n_answers; ++i) {
    const Answer& answer = record_.answers[i];
    const bool about_fixtures = answer.kind == CommandItem::Kind::kSetFixture ||
                                answer.kind == CommandItem::Kind::kRemoveFixture;
    if (!about_fixtures || answer.reason != surg::Reason::kNone) continue;
    record_.fixtures = controller_.fixtures();
    ++record_.fixtures_version;
  }
}

surg::Reason ControlCycle::change_tool(const surg::MountedTool& tool) {
  const surg::Reason reason = box_.change_tool(tool.instrument, tool.tool);
  if (reason == surg::Reason::kNone) record_.tool = &tool;
  return reason;
}

surg::Reason ControlCycle::set_frame(const CommandItem& item) {
  // The targets of a moving arm would change their meaning.
  if (enabled_) return surg::Reason::kFrameWhileEnabled;
  record_.frame.name = item.frame;
  record_.frame.X_UR = item.X_UR;
  ++record_.frame.version;
  return surg::Reason::kNone;
}

bool ControlCycle::is_sliding(std::uint32_t source) const {
  return std::find(sliding_.begin(), sliding_.end(), source) != sliding_.end();
}

surg::Reason ControlCycle::set_sliding(std::uint32_t source, bool slide) {
  std::replace(sliding_.begin(), sliding_.end(), source, 0U);
  if (!slide) return surg::Reason::kNone;
  const auto room = std::find(sliding_.begin(), sliding_.end(), 0U);
  if (room == sliding_.end()) return surg::Reason::kRefusedTransition;
  *room = source;
  return surg::Reason::kNone;
}

surg::Reason ControlCycle::take_track(const CommandItem& item, std::int64_t now_ns) {
  // Two alternating trackers would shake the pivot (F26).
  if (track_.source != 0 && track_.source != item.source &&
      now_ns - track_.received_ns < kTrackHeldNs) {
    return surg::Reason::kNoAuthority;
  }
  // A sample's age follows from its stamp relative to the link's, where the two clocks agree,
  // because cameras have latency. A stamp from the future or from another clock is not trusted
  // (F09).
  const auto age = static_cast<std::int64_t>(record_.stamp_ns - item.stamp_ns);
  const bool trusted = item.stamp_ns != 0 && record_.stamp_ns != 0 && age > 0 && age <= kTrackAgeNs;
  const std::int64_t received = item.received_ns == 0 ? now_ns : item.received_ns;
  track_ = {received - (trusted ? age : 0), item.source, item.p_B, item.v_B};
  return surg::Reason::kNone;
}

/// Adds a motion to the inputs, converted from the user's frame to R.
surg::Reason ControlCycle::take_motion(const CommandItem& item, std::int64_t now_ns) {
  if (item.motion.motion != surg::Motion::kHold && stamps_seen_.is_late(item.stamp_ns)) {
    ++record_.refused_by_cycle;
    return surg::Reason::kLate;
  }
  const bool twist = item.motion.motion == surg::Motion::kServoCv;
  const bool pose = is_pose(item.motion.motion);
  if ((pose || twist) && !item.frame.empty() && item.frame != record_.frame.name) {
    record_.wrong_frame = item.frame;
    ++record_.refused_by_cycle;
    return surg::Reason::kWrongFrame;
  }
  surg::MotionCommand& motion = inputs_.commands[inputs_.n_commands++];
  motion = item.motion;
  motion.source = item.source;
  motion.stamp_ns = static_cast<std::int64_t>(item.stamp_ns);
  motion.age = item.received_ns == 0 ? 0 : seconds(now_ns - item.received_ns);
  motion.slide = is_sliding(item.source);
  const surg::Pose& X_UR = record_.frame.X_UR;
  if (pose) {
    const ToolPose target = pose_to_rcm(X_UR, {motion.p, motion.rotation});
    motion.p = target.p;
    motion.rotation = target.q;
    if (!record_.out.wrist.exists && ignored_tilt(target) > kTiltTolerance)
      record_.orientation = {motion.motion, item.source};
  } else if (twist) {
    const ToolTwist rates = twist_to_rcm(X_UR, {motion.p, item.angular});
    // Shaft of the last cycle, 2 ms old: the axis turns by less than 0.5 degrees in that time.
    const surg::Vector3 s_R = record_.X_BR.linear().transpose() * record_.out.s_B;
    motion.p = rates.v;
    motion.omega = rates.omega;
    motion.roll_rate = rates.omega.dot(s_R);
    if (!record_.out.wrist.exists &&
        (rates.omega - motion.roll_rate * s_R).norm() > kAngularTolerance) {
      record_.angular = {motion.motion, item.source};
    }
  }
  return surg::Reason::kNone;
}

void ControlCycle::sense(const LinkState& link, std::int64_t now_ns) {
  inputs_.state_valid = link.stamp_ns != 0;
  inputs_.state_age = inputs_.state_valid ? seconds(now_ns - link.received_ns) : 0;
  inputs_.q = link.q;
  inputs_.qd = link.qd;
  inputs_.condition = link.condition;
  inputs_.condition_age = age(link.condition_received_ns, now_ns);
  inputs_.jaw = link.jaw;
  inputs_.jaw_age = age(link.jaw_received_ns, now_ns);
  inputs_.wrist = link.wrist;
  inputs_.wrist_rate = link.wrist_rate;
  // Near the trocar a sensor at the flange cannot tell the two forces apart.
  const bool required = record_.out.depth > force_depth_;
  inputs_.tip_force = force_of(link.tip, now_ns, required);
  inputs_.trocar_force = force_of(link.trocar, now_ns, required);
  for (std::size_t i = 0; i < link.others.size(); ++i) {
    const OtherState& other = link.others[i];
    inputs_.others[i] = {other.received_ns != 0, seconds(now_ns - other.received_ns), other.q,
                         other.qd};
  }
  inputs_.track_valid = track_.source != 0;
  inputs_.track_age = inputs_.track_valid ? seconds(now_ns - track_.received_ns) : 0;
  inputs_.p_BTrack = track_.p_B;
  inputs_.v_BTrack = track_.v_B;
}

/// The shaft direction through pivot and tip; the measured axis where the tip is at the pivot.
Eigen::Quaterniond ControlCycle::orientation_at(const surg::Vector3& p_B, double roll) const {
  const surg::Vector3 along = p_B - record_.out.p_BRcm;
  const double length = along.norm();
  const surg::Vector3 s_B = length > 1e-6 ? surg::Vector3(along / length) : record_.out.s_B;
  return controller_.tool_orientation(s_B, roll);
}

const CycleRecord& ControlCycle::run(const LinkState& link, std::int64_t now_ns,
                                     std::int64_t elapsed_ns, const CommandItem* items,
                                     std::size_t count) {
  record_.n_answers = 0;
  record_.orientation = record_.angular = {};
  inputs_.n_commands = 0;
  const std::size_t taken = std::min<std::size_t>(count, surg::kMaxCommands);
  for (const bool motions : {false, true}) {
    for (std::size_t i = 0; i < taken; ++i) {
      const CommandItem& item = items[i];
      const bool motion = item.kind == CommandItem::Kind::kMotion;
      if (motion != motions) continue;
      // Many clients send 'home' by default. Here it has no effect, and the motion sent next must
      // not find an is_busy that is not its own.
      if (is_home(item) && enabled_ && homed_) continue;
      if (is_waited_for(item)) ++record_.moves;
      if (item.kind == CommandItem::Kind::kTool || item.kind == CommandItem::Kind::kSetRcm) {
        homed_ = false;  // until the step below says otherwise
      }
      const surg::Reason reason = answer(item, now_ns);
      if (motion && reason == surg::Reason::kNone) continue;  // the controller gives its verdict
      record_.answers[record_.n_answers++] = {item.kind, item.state,  item.motion.motion,
                                              reason,    item.source, item.slide};
    }
  }
  note_fixtures();
  sense(link, now_ns);
  inputs_.elapsed = seconds(elapsed_ns);

  const auto start = std::chrono::steady_clock::now();
  const surg::Outputs& out = box_.step(inputs_);
  const auto end = std::chrono::steady_clock::now();

  enabled_ = out.state == surg::State::kEnabled;
  homed_ = out.homed;
  stamps_seen_.add(link.stamp_ns, out.motion);
  record_.stamp_ns = link.stamp_ns;
  record_.q = link.q;
  record_.qd = link.qd;
  record_.out = out;
  record_.X_BR = controller_.X_BR();
  if (out.wrist.exists) {
    record_.q_RTool = out.wrist.R_RTip;
    record_.q_RSet = out.wrist.R_RSet;
    record_.q_RGoal = out.wrist.R_RGoal;
  } else {
    record_.q_RTool = controller_.tool_orientation(out.s_B, out.roll);
    record_.q_RSet = orientation_at(out.p_set, out.roll_set);
    record_.q_RGoal = orientation_at(out.p_goal, out.roll_goal);
  }
  record_.compute_us = std::chrono::duration<double, std::micro>(end - start).count();
  return record_;
}

}  // namespace surg_control
