// How far tip and pivot can still go from now until rest, whatever stops the arm: the controller
// dies, the link falls silent, or the robot stops by itself (docs/design/stop_bound.md).
#pragma once

#include <array>
#include <limits>

#include "surg_core/config.hpp"
#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/law/rcm.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// How far an arm can still go from now until rest.
struct StopBound {
  double tip = std::numeric_limits<double>::quiet_NaN();    ///< [m] from where it is measured
  double pivot = std::numeric_limits<double>::quiet_NaN();  ///< [m] of the shaft from the trocar
};

/// [s] Longest time for which a link goes on with a command. T [s]: control period, within which it
/// notices the silence.
inline double held_at_most(const Tuning& tuning, double T) {
  return tuning.link_lag + tuning.dead_man + T;
}

/// What may happen to an arm until it is at rest: the stated ranges.
struct StopRanges {
  double dead_man = 0;      ///< [s] without a command, after which the link stops the arm
  double deceleration = 0;  ///< [rad/s^2] of the leading joint in that stop
  JointVector least, most;  ///< [rad/s^2] of each joint when the robot stops by itself
};

/// Bounds the way to rest from the commands that may still reach the arm. Between two of them it
/// holds the last one until the link's dead-man stops it; at any moment the robot may stop by
/// itself, each joint with a deceleration of its own or all along their path.
class StopEstimator {
 public:
  /// T [s]: control period.
  StopEstimator(const StopRanges& ranges, double T) : ranges_(ranges), T_(T) {}

  /// Adds the command of one period [rad/s].
  void add(const JointVector& qd_command);

  /// A measured state, and what is needed to see it as tip and pivot.
  struct Now {
    const JointVector &q, &qd;  ///< [rad, rad/s]
    double age;                 ///< [s] of this state
    double lag;                 ///< [s] most delay of the link, and most lag of a joint
    Tool tool;
    Vector3 p_BRcm;
  };
  /// Never allocates.
  StopBound bound(const Chain& chain, const Now& now) const;

  /// The commands of the last periods [rad/s].
  struct Commands {
    static constexpr int kMost = 128;  // [periods] that are remembered
    Commands() { sent.fill(Joints::Zero()); }
    const Joints& ago(int periods) const { return sent[(newest - periods) & (kMost - 1)]; }
    int newest = 0;
    std::array<Joints, kMost> sent;
  };
  /// Everything that a bound depends on besides what it is given (snapshot.hpp).
  Commands& commands() { return commands_; }

 private:
  StopRanges ranges_;
  double T_;
  Commands commands_;
};

}  // namespace surg
