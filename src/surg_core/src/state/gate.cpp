#include "surg_core/state/gate.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

/// [s] in which a stream may have moved since its last accepted sample.
double step_time(const Limits& limits, bool begins, double since) {
  return begins ? 0.0 : std::min(since, limits.step_dt_max);
}

}  // namespace

Reason check_step(const Limits& limits, bool begins, double since, double distance,
                  double roll_distance) {
  const double dt = step_time(limits, begins, since);
  // Written so that NaN is refused.
  const bool near = distance <= limits.tip_velocity * dt + limits.step_slack &&
                    std::abs(roll_distance) <= limits.roll_velocity * dt + limits.step_roll_slack;
  if (near) return Reason::kNone;
  return begins ? Reason::kStreamStartTooFar : Reason::kStepTooLarge;
}

Reason check_wrist_step(const Limits& limits, const WristConfig& wrist, bool begins, double since,
                        double turned) {
  const double dt = step_time(limits, begins, since);
  if (turned <= wrist.velocity * dt + limits.step_roll_slack) return Reason::kNone;
  return begins ? Reason::kStreamStartTooFar : Reason::kStepTooLarge;
}

}  // namespace surg
