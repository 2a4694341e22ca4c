#include "haptics.hpp"

#include <algorithm>
#include <cmath>

namespace surg_teleop {
namespace {

// Time constants with which the share of the wanted force falls and comes back [s].
constexpr double kWeaken = 0.005;
constexpr double kRecover = 0.5;
// Energy below which no more is given out [J]: what the speed's error costs.
constexpr double kFloor = -4e-4;
constexpr double kTiny = 1e-12;  // [N]

}  // namespace

double PassivityChannel::step(double wanted, double position, double dt) {
  const double way = std::isnan(position_) ? 0.0 : position - position_;
  energy_ -= force_ * way;
  position_ = position;
  const double speed = way / dt;
  if (energy_ < kFloor / 4 && wanted * way >= 0.0) {
    share_ *= std::max(0.0, 1.0 - dt / kWeaken);
  } else {
    share_ += (1.0 - share_) * dt / kRecover;
  }
  double force = share_ * wanted;
  const double left = energy_ - force * way;  // after another step like the last one
  if (left < 0.0 && way != 0.0) {
    force -= std::min(-left / (way * speed), largest_damping_) * speed;
  }
  if (energy_ < kFloor && force * way > 0.0) force = 0.0;
  force_ = std::clamp(force, -largest_force_, largest_force_);
  return force_;
}

void PassivityChannel::rest(double position) {
  if (!std::isnan(position_)) energy_ -= force_ * (position - position_);
  energy_ = std::min(energy_, 0.0);
  position_ = position;
  force_ = 0.0;
}

HapticFeedback::HapticFeedback(const HapticLimits& limits)
    : limits_(limits),
      axes_{PassivityChannel(limits.damping, limits.max_force),
            PassivityChannel(limits.damping, limits.max_force),
            PassivityChannel(limits.damping, limits.max_force)} {}

void HapticFeedback::reset() { *this = HapticFeedback(limits_); }

Eigen::Vector3d HapticFeedback::step(const Eigen::Vector3d& force, double age,
                                     const Eigen::Vector3d& position, bool allowed, double dt) {
  if (!position.allFinite() || !(dt > 0.0)) {
    reset();
    return Eigen::Vector3d::Zero();
  }
  const bool known = force.allFinite() && age >= 0.0 && age <= limits_.silent_after;
  if (known) {
    Eigen::Vector3d wanted = limits_.scale * force;
    wanted *= std::min(1.0, limits_.max_force / std::max(wanted.norm(), kTiny));
    const Eigen::Vector3d change = wanted - smooth_;
    smooth_ += change * std::min(1.0, limits_.max_rate * dt / std::max(change.norm(), kTiny));
  }
  gate_ += known && allowed ? dt / limits_.fade_in : -dt / limits_.fade_out;
  gate_ = std::clamp(gate_, 0.0, 1.0);
  Eigen::Vector3d out = Eigen::Vector3d::Zero();
  if (gate_ == 0.0) {
    smooth_.setZero();
    for (Eigen::Index i = 0; i < 3; ++i) axes_[static_cast<std::size_t>(i)].rest(position[i]);
    return out;
  }
  for (Eigen::Index i = 0; i < 3; ++i) {
    out[i] = axes_[static_cast<std::size_t>(i)].step(gate_ * smooth_[i], position[i], dt);
  }
  return out;
}

}  // namespace surg_teleop
