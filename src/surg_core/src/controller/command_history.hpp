// What the arm may be doing, judged by the commands that it was given last.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "surg_core/types.hpp"

namespace surg {

/// The last commands of a controller [rad/s]. An arm that obeys them late moves with a velocity
/// between the smallest and the largest of them; while a command stands, it comes closer to it.
class CommandHistory {
 public:
  /// A link is expected to answer within kReach cycles and with a time constant up to kLag.
  static constexpr int kReach = 20;
  static constexpr double kLag = 0.02;    ///< [s]
  static constexpr double kDelay = 0.01;  ///< [s]

  void add(const JointVector& qd) {
    newest_ = (newest_ + 1) % kReach;
    commands_[newest_] = qd;
  }
  /// Whether the commands explain measured joint velocities, to within 'slack' [rad/s], when the
  /// last one has stood for 'standing' [s]. If not, something else has moved or stopped the arm.
  bool explains(const JointVector& measured, const JointVector& slack, double standing) const {
    const JointVector& last = commands_[newest_];
    const double left = std::exp(-std::max(standing - kDelay, 0.0) / kLag);
    for (Eigen::Index i = 0; i < measured.size(); ++i) {
      double low = last[i], high = last[i];
      for (const JointVector& command : commands_) {
        if (command.size() <= i) continue;  // none was given yet
        low = std::min(low, command[i]);
        high = std::max(high, command[i]);
      }
      const double below = last[i] - left * (last[i] - low),
                   above = last[i] + left * (high - last[i]);
      if (!(measured[i] >= below - slack[i] && measured[i] <= above + slack[i])) return false;
    }
    return true;
  }

 private:
  std::array<JointVector, kReach> commands_;
  int newest_ = 0;
};

}  // namespace surg
