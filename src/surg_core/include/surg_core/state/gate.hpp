// Command authority and the step test of streams. Nothing is clipped: a command is accepted, or
// refused with a reason.
#pragma once

#include <cstdint>

#include "surg_core/config.hpp"
#include "surg_core/state/operating_state.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Command authority: held by the first accepted sender until the arm has rested 0.5 s without a
/// command (F26).
class Authority {
 public:
  explicit Authority(double dt) : dt_(dt) {}
  bool may_command(std::uint32_t source) const { return holder_ == 0 || holder_ == source; }
  /// The elbow moves no tip: anybody may turn it, until somebody claims the arm.
  bool may_turn_elbow(std::uint32_t source) const { return !claimed_ || holder_ == source; }
  void taken(std::uint32_t source) {
    holder_ = source;
    silent_ = 0;
  }
  /// Gives 'source' exclusive authority until the arm leaves ENABLED, at rest or not.
  void claim(std::uint32_t source) {
    taken(source);
    claimed_ = true;
  }
  /// Call it once per cycle. resting: set-point and jaw are at rest and no motion is on its way;
  /// enabled: the arm is ENABLED.
  void elapse(bool resting, bool enabled) {
    silent_ = resting ? silent_ + dt_ : 0;
    if (was_enabled_ && !enabled) claimed_ = false;
    was_enabled_ = enabled;
    if (!claimed_ && (!enabled || silent_ >= kRelease)) holder_ = 0;
  }
  std::uint32_t holder() const { return holder_; }

 private:
  static constexpr double kRelease = 0.5;  // [s] of rest that frees the arm (F26)
  double dt_;
  double silent_ = 0;         // [s] at rest without a command
  std::uint32_t holder_ = 0;  // 0: nobody
  bool claimed_ = false;
  bool was_enabled_ = false;
};

/// Step test of a pose stream (servo_cp, servo_jp). Distances from the last accepted pose, or from
/// the set-point where a stream begins; 'since' is the time since the last accepted one [s].
Reason check_step(const Limits& limits, bool begins, double since, double distance,
                  double roll_distance);

/// The same of the wrist's joints; turned [rad]: by the one that turns farther.
Reason check_wrist_step(const Limits& limits, const WristConfig& wrist, bool begins, double since,
                        double turned);

}  // namespace surg
