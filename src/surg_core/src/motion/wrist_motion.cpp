#include "surg_core/motion/wrist_motion.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace surg {
namespace {

constexpr double kTurned = 0.05;  // [rad] off the set-point at a start: turned by hand
constexpr double kAway = 0.3;     // [rad] off the place of a drive that lags as stated: blocked
constexpr double kEndApproach = 10.0;  // [1/s] speed of a joint over what is left of its range
constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

}  // namespace

WristMotion::WristMotion(const std::optional<WristConfig>& wrist, const Tuning& tuning)
    : exists_(wrist.has_value()),
      duration_(tuning.profiler_duration),
      input_(tuning.stream_delay, tuning.tremor) {
  if (wrist) config_ = *wrist;
}

DofLimits WristMotion::limits() const {
  return {config_.velocity, config_.acceleration, config_.jerk()};
}

void WristMotion::sense(const DriveJoints& measured, double elapsed) {
  if (!exists_ || !measured.allFinite()) return;
  measured_ = measured;
  if (!known_) {
    known_ = true;
    expected_ = measured;
    start();
  }
  const bool away = (measured - expected_).cwiseAbs().maxCoeff() > kAway;
  away_ = away ? away_ + elapsed : 0;
}

void WristMotion::start() {
  if (!exists_) return;
  stop();
  if (mode_ != Mode::kRest) return;  // it comes to rest where it can
  away_ = 0;
  for (int i = 0; i < kJoints; ++i) {
    const bool turned = !(std::abs(measured_[i] - dofs_[i].x) <= kTurned);
    dofs_[i] = {turned ? measured_[i] : dofs_[i].x, 0, 0};
  }
  if (known_) expected_ = measured_;
  goal_ = set();
}

void WristMotion::stop() {
  const bool moves = dofs_[0].v != 0 || dofs_[1].v != 0 || dofs_[2].v != 0;
  mode_ = moves ? Mode::kStopping : Mode::kRest;
}

void WristMotion::restart_filters() {
  for (int i = 0; i < kJoints; ++i) {
    filters_[i] = StreamFilter(limits());
    filters_[i].reset(dofs_[i]);
  }
}

void WristMotion::stream(const DriveJoints& target, double age, std::int64_t stamp_ns) {
  goal_ = target;
  const Values x{target[0], target[1], target[2], 0};
  if (mode_ == Mode::kStream) {
    input_.add(x, age, stamp_ns);
    return;
  }
  mode_ = Mode::kStream;
  restart_filters();
  const double most = config_.acceleration;
  input_.begin(x, {dofs_[0], dofs_[1], dofs_[2], Kinematic{}}, {most, most, most, 0}, age,
               stamp_ns);
}

void WristMotion::set_velocity(const DriveJoints& rates) {
  if (mode_ != Mode::kVelocity) restart_filters();
  mode_ = Mode::kVelocity;
  rates_ = rates;
}

void WristMotion::move_to(const DriveJoints& target) {
  goal_ = target;
  const DofLimits joint = limits();
  profiler_ = Profiler({joint, joint, joint, joint}, duration_);
  profiler_.reset({dofs_[0], dofs_[1], dofs_[2], Kinematic{}});
  profiler_.plan({target[0], target[1], target[2], 0});
  mode_ = Mode::kProfile;
}

bool WristMotion::reaches(const DriveJoints& joints) const {
  return (joints.array() >= config_.min.array()).all() &&
         (joints.array() <= config_.max.array()).all();
}

DriveJoints WristMotion::nearest(const DriveJoints& joints) const {
  return joints.cwiseMax(config_.min).cwiseMin(config_.max);
}

void WristMotion::elapse(double T, bool heard, double delay) {
  if (!exists_) return;
  input_.elapse(T, heard, delay);
  const double share = T / (std::max(config_.drive_lag, T));
  const DriveJoints told = command(0);
  if (known_) expected_ += share * (told - expected_);
}

void WristMotion::begin_cycle(double period, double rest) {
  period_ = period;
  input_.begin_cycle(rest);
}

void WristMotion::advance(double dt) {
  if (!exists_ || !(dt > 0)) return;
  const DriveJoints before = set();
  step(dt);
  // A filter overshoots and a stop takes its way: the drive stays at its end, so the set-point
  // does.
  for (int i = 0; i < kJoints; ++i) {
    const double end = nearest(set())[i];
    const bool was_inside = before[i] >= config_.min[i] && before[i] <= config_.max[i];
    if (was_inside && dofs_[i].x != end) dofs_[i] = {end, 0, 0};
  }
}

void WristMotion::step(double dt) {
  switch (mode_) {
    case Mode::kRest:
      return;
    case Mode::kStream: {
      const StreamInput::State target = input_.target(dt), hand = input_.estimate(dt);
      const bool delayed = input_.delayed();
      for (int i = 0; i < kJoints; ++i) {
        filters_[i].step(target[i], dt, period_, delayed ? &hand[i] : nullptr);
        dofs_[i] = filters_[i].state();
      }
      return;
    }
    case Mode::kVelocity:
      advance_velocity(dt);
      return;
    case Mode::kProfile:
      profiler_.advance(dt);
      for (int i = 0; i < kJoints; ++i) dofs_[i] = profiler_.state()[i];
      if (profiler_.done()) mode_ = Mode::kRest;
      break;
    case Mode::kStopping:
      advance_stopping(dt);
      break;
  }
  if (mode_ == Mode::kRest) {
    for (Kinematic& joint : dofs_) joint.v = joint.a = 0;
  }
}

DriveJoints WristMotion::allowed(const DriveJoints& rates) const {
  const double fastest = rates.cwiseAbs().maxCoeff();
  const double share = fastest > config_.velocity ? config_.velocity / fastest : 1.0;
  DriveJoints out;
  for (int i = 0; i < kJoints; ++i) {
    const double end = rates[i] > 0 ? config_.max[i] : config_.min[i];
    const double most = kEndApproach * std::abs(end - dofs_[i].x);
    out[i] = std::clamp(share * rates[i], -most, most);
  }
  return out;
}

void WristMotion::advance_velocity(double dt) {
  const DriveJoints rates = allowed(rates_);
  for (int i = 0; i < kJoints; ++i) {
    const Kinematic& now = dofs_[i];
    filters_[i].step({now.x + now.v * dt + 0.5 * now.a * dt * dt, rates[i], 0}, dt);
    dofs_[i] = filters_[i].state();
  }
}

void WristMotion::advance_stopping(double dt) {
  bool rests = true;
  for (Kinematic& joint : dofs_) {
    const double slower = std::max(0.0, std::abs(joint.v) - config_.acceleration * dt);
    const double next = std::copysign(slower, joint.v);
    joint = {joint.x + 0.5 * (joint.v + next) * dt, next, 0};
    rests = rests && slower == 0;
  }
  if (rests) mode_ = Mode::kRest;
}

/// A critically damped servo of second order with lag L answers y + L y' + L^2 y'' / 4 with y. A
/// first order has no term of y'', a dead time one of twice the size. y is x one arm lag ago.
DriveJoints WristMotion::command(double arm_lag) const {
  if (!known_) return DriveJoints::Constant(kUnknown);
  const double lag = config_.drive_lag;
  const double bend = 0.25 * lag * lag - lag * arm_lag + 0.5 * arm_lag * arm_lag;
  DriveJoints ahead;
  for (int i = 0; i < kJoints; ++i) {
    ahead[i] = dofs_[i].x + (lag - arm_lag) * dofs_[i].v + bend * dofs_[i].a;
  }
  return nearest(ahead);
}

}  // namespace surg
