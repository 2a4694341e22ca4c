#include "surg_core/motion/jaw.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace surg {
namespace {

constexpr double kArrived = 0.02;  // [rad] from the target: the jaw has arrived
// A jaw that holds tissue, or is unseen, never gets there.
constexpr double kJawArriveWithin = 0.5;  // [s] of a move, then it is given up
constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

}  // namespace

Jaw::Jaw(const InstrumentConfig& instrument, double dt)
    : min_(instrument.jaw_min),
      max_(instrument.jaw_max),
      velocity_(instrument.jaw_velocity),
      dt_(dt),
      set_(kUnknown),
      goal_(kUnknown),
      measured_(kUnknown) {}

void Jaw::sense(double measured) {
  measured_ = measured;
  if (std::isfinite(set_) || !std::isfinite(measured)) return;
  set_ = std::clamp(measured, min_, max_);
  if (!std::isfinite(goal_)) goal_ = set_;
}

void Jaw::go_to(double angle, bool move) {
  goal_ = std::clamp(angle, min_, max_);
  busy_ = move;
  settle_ = 0;
}

void Jaw::hold() {
  goal_ = set_;
  busy_ = false;
}

void Jaw::advance(bool may_move, int periods) {
  if (!may_move) return;
  const bool seen = std::isfinite(set_);
  if (seen) {
    const double most = velocity_ * dt_;
    set_ += std::clamp(goal_ - set_, -most, most);
  }
  if (!busy_ || (seen && set_ != goal_)) return;
  settle_ += periods * dt_;
  const bool arrived = std::abs(measured_ - set_) <= kArrived && settle_ > kEdge;
  if (arrived || settle_ > kJawArriveWithin) busy_ = false;
}

}  // namespace surg
