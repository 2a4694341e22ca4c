// Joint velocities and alphas that the limits allow in one cycle: velocity, acceleration, and
// braking distance before a position limit.
#pragma once

#include <algorithm>
#include <array>

#include "limits/limited_laws.hpp"
#include "surg_core/limits/limited_step.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Maximum speed towards a position limit at 'distance' [rad], braking with at most a [rad/s^2].
/// Inside the margin [rad] the joint approaches gently: an arm with lag would pass a limit if the
/// joint braked at full deceleration right before it.
double approach_speed(double distance, double a, double margin, double T);
/// The same, at most 'most' [rad/s]: no square roots far from the limit.
inline double approach_speed(double most, double distance, double a, double margin, double T) {
  // More than it takes to brake from 'most' before the margin.
  if (a * (distance - margin) > most * (most + 2 * a * T)) return most;
  return std::min(most, approach_speed(distance, a, margin, T));
}

/// The alphas that the joints allow, with the reason for the upper end.
struct AlphaRange {
  double low = 0, high = 1;
  const char* high_by = "";

  /// Keeps lowest <= at_0 + alpha rate <= highest.
  void keep(double at_0, double rate, double lowest, double highest, const char* low_by,
            const char* top_by);
  bool empty() const { return !(low <= high); }
};

/// The joint velocities [rad/s] of one cycle, each between two values.
class LimitedStep::Box {
 public:
  /// T: control period [s].
  Box(const JointLimits& limits, double T, const Here& here);

  bool holds(const Joints& qd) const;
  Joints clamped(const Joints& qd) const;
  JointVector unpadded(const Joints& qd) const { return qd.head(n_); }
  /// The alphas for which qd0 + alpha qd1 is inside.
  AlphaRange alphas(const Joints& qd0, const Joints& qd1) const;
  /// The shares in [0, 1] for which, at some alpha in [0, 1], qd0 + share back + alpha qd1 is
  /// inside.
  AlphaRange shares(const Joints& qd0, const Joints& back, const Joints& qd1) const;
  /// The alpha in [0, highest] that leaves the box least.
  double least_beyond(const Joints& qd0, const Joints& qd1, double highest) const;
  /// The joint velocities nearest to 'wanted' inside the box with rows J qd = J wanted + e. Returns
  /// what is left of the rows.
  double nearest_on_rows(const RcmRows& rows, const JointVector& wanted, JointVector& qd) const;

 private:
  Eigen::Index n_;
  Joints low_ = Joints::Zero(), high_ = Joints::Zero();
  std::array<const char*, kMaxJoints> low_by_, high_by_;
};

}  // namespace surg
