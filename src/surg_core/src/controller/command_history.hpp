// What the arm may be doing, judged by the commands that it was given last.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "surg_core/types.hpp"

namespace surg {

/// The last commands of a controller [rad/s], as their range per slot of a few cycles. An arm that
/// obeys them late moves with a velocity between the smallest and the largest of them; while a
/// command stands, it comes closer to it.
class CommandHistory {
 public:
  static constexpr int kSlots = 20;       ///< ranges of commands that are remembered
  static constexpr double kReach = 0.04;  ///< [s] beyond the time-out in which a link obeys
  static constexpr double kLag = 0.02;  ///< [s] time constant with which a link obeys at the latest
  static constexpr double kDelay = 0.01;  ///< [s] after which it begins to obey at the latest

  /// link_timeout [s]: a link that obeys later counts as lost. T [s]: control period.
  CommandHistory(double link_timeout, double T)
      : cycles_(static_cast<int>(std::ceil((kReach + link_timeout) / (kSlots * T)))) {}

  void add(const JointVector& qd) {
    last_ = qd;
    Slot& slot = slots_[newest_];
    if (in_slot_ < cycles_ && slot.low.size() == qd.size()) {
      ++in_slot_;
      slot = {slot.low.cwiseMin(qd), slot.high.cwiseMax(qd)};
      return;
    }
    in_slot_ = 1;
    newest_ = (newest_ + 1) % kSlots;
    slots_[newest_] = {qd, qd};
  }
  /// Whether the commands explain measured joint velocities, to within 'slack' [rad/s], when the
  /// last one has stood for 'standing' [s]. If not, something else has moved or stopped the arm.
  bool explains(const JointVector& measured, const JointVector& slack, double standing) const {
    const double left = std::exp(-std::max(standing - kDelay, 0.0) / kLag);
    for (Eigen::Index i = 0; i < measured.size(); ++i) {
      if (last_.size() <= i) return true;  // none was given yet
      double low = last_[i], high = last_[i];
      for (const Slot& slot : slots_) {
        if (slot.low.size() <= i) continue;
        low = std::min(low, slot.low[i]);
        high = std::max(high, slot.high[i]);
      }
      const double below = last_[i] - left * (last_[i] - low),
                   above = last_[i] + left * (high - last_[i]);
      if (!(measured[i] >= below - slack[i] && measured[i] <= above + slack[i])) return false;
    }
    return true;
  }

 private:
  struct Slot {
    JointVector low, high;
  };

  int cycles_;  // of one slot
  std::array<Slot, kSlots> slots_;
  JointVector last_;
  int newest_ = 0, in_slot_ = 0;
};

}  // namespace surg
