// Notices an arm that stands still although it is told to move, at any speed and under every law.
#pragma once

#include "surg_core/types.hpp"

namespace surg {

/// Compares the joints' commanded with their measured displacement over the last second or so. Both
/// are sums that fade out, so an arm that lags, or a hand that trembles, is no standstill. The
/// measured one is taken from positions: their noise does not add up.
class StandstillGuard {
 public:
  static constexpr double kMemory = 1.0;      ///< [s] time constant of both displacements
  static constexpr double kCommanded = 1e-3;  ///< [rad] commanded displacement that must be seen
  static constexpr double kShare = 0.25;      ///< of the commanded displacement that must be seen
  static constexpr double kLasting = 0.2;     ///< [s] of a standstill, beyond the link's time-out

  /// link_timeout [s]: a link may obey that late.
  explicit StandstillGuard(double link_timeout) : patience_(kLasting + link_timeout) {}

  /// Call it once per cycle. qd: commanded in the last cycle [rad/s]; q: measured [rad]; dt [s]:
  /// since the last cycle. Returns whether the arm stands still against its commands.
  bool stands_still(const JointVector& qd, const JointVector& q, double dt);
  /// Forgets what was commanded, for cycles in which the arm need not obey.
  void restart() { started_ = false; }

 private:
  double patience_;
  bool started_ = false;
  double lasted_ = 0;  // [s]
  JointVector q_last_, commanded_, measured_;
};

}  // namespace surg
