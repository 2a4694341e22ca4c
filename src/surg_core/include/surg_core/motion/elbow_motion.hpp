// Turns the elbow of a seven-joint arm to a chosen angle while flange, tip and pivot stay: slowly,
// with a small share of the joints' speed and acceleration, inside every joint limit.
#pragma once

#include <cmath>
#include <limits>

#include "surg_core/kinematics/elbow.hpp"
#include "surg_core/limits/barrier.hpp"
#include "surg_core/limits/limited_step.hpp"
#include "surg_core/state/operating_state.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// The elbow's goal, and the null-space velocity that leads there. Without a goal it asks for
/// nothing. The tip's motion has priority: a joint near its limit holds the elbow or turns it back.
class ElbowMotion {
 public:
  static constexpr double kTolerance = 2e-3;  ///< [rad] within which a goal is reached
  static constexpr int kNobody = -1;          ///< no joint holds the elbow

  /// preferred [rad]: goal from 'home' on; NaN: none. T [s]: control period.
  ElbowMotion(const Chain& chain, const JointLimits& limits, double preferred, double T);

  /// The preferred goal, at rest.
  void home();
  /// At rest; the goal stays.
  void rest() { rate_ = 0; }
  /// Takes a goal [rad] if turning from q with the flange at rest leads there. kElbowOutOfReach: it
  /// does not; 'by' says what is in between, as limited_by().
  Reason go_to(double angle, const JointVector& q, int& by);
  /// Brakes and stays there, if it has a goal.
  void hold();

  /// Null-space velocity for the next cycle from joints q [rad/s]. may_turn: false brakes.
  JointVector advance(const JointVector& q, bool may_turn);

  bool has_goal() const { return stopping_ || std::isfinite(goal_); }
  double goal() const { return goal_; }  ///< [rad]; NaN: none
  /// The goal is a command's, or where a stop left the elbow.
  bool commanded() const { return commanded_; }
  /// A commanded turn is under way.
  bool busy() const { return busy_; }
  /// What holds the elbow away from its goal: a joint's index, or the number of joints for a
  /// singularity or an undefined angle; kNobody: nothing.
  int limited_by() const { return limited_by_; }

  template <typename Archive>
  void serialize(Archive& archive) {
    archive(goal_, rate_, commanded_, stopping_, busy_, limited_by_);
  }

 private:
  /// Rates of the elbow that joint limits and singularities allow [rad/s], and what sets them.
  struct Range {
    double low, high;
    int low_by, high_by;
    void limit_up(double fastest, int by) {
      if (!(fastest < high)) return;
      high = fastest;
      high_by = by;
    }
    void limit_down(double fastest, int by) {
      if (!(-fastest > low)) return;
      low = -fastest;
      low_by = by;
    }
  };
  struct Here;
  Here at(const JointVector& q) const;
  Range range(const Here& here, double fastest) const;
  void limit_joints(const Here& here, Range& range) const;
  void limit_approach(const Here& here, Range& range) const;
  double wanted_rate(const Here& here, double fastest, double acceleration);

  Chain chain_;
  JointLimits limits_;
  Barrier barrier_;
  double preferred_, T_;
  double goal_ = std::numeric_limits<double>::quiet_NaN();
  double rate_ = 0;         // [rad/s] of the elbow
  bool commanded_ = false;  // the goal is a command's, not the preferred one
  bool stopping_ = false;   // the goal is where it comes to rest
  bool busy_ = false;
  int limited_by_ = kNobody;
};

}  // namespace surg
