// What every law is given: the arm, the instrument, the trocar, the limits and the path of the tip.
#pragma once

#include <string>
#include <vector>

#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/law/exact.hpp"
#include "surg_core/law/rcm.hpp"
#include "surg_core/limits/limited_step.hpp"

namespace bench {

constexpr double T = 0.002;  // control period [s]

// Feedback gains of every law that works on velocities [1/s].
constexpr double kRcmGain = 50, kTipGain = 10, kRollGain = 10, kPostureGain = 1;

/// The arm of a cell, as benchmarks/control/bench_scene.py writes it.
struct Scene {
  std::string name;
  surg::Chain chain;
  surg::JointVector q_home;
  surg::JointLimits limits;
  surg::Tool tool;
  surg::Home home;
  surg::Vector3 p_BRcm;
  std::vector<surg::Vector3> p_BTip;  ///< the tip at k T

  /// The tip in the time between samples, by linear interpolation.
  surg::Vector3 tip(double t) const;
};
Scene read_scene(const std::string& arm_file, const std::string& path_file);

/// What a law is asked for in one cycle. The instrument's roll is to stay 0 (absolute).
struct Goal {
  const Scene* scene;
  std::size_t k;                ///< cycle, the tip is to be at p_BTip[k + 1] at its end
  surg::Vector3 p_now, p_next;  ///< [m]
};

/// One way to do the task: joint velocities for the coming cycle.
class Law {
 public:
  virtual ~Law() = default;
  /// q [rad], qd_last [rad/s] of the cycle before; returns qd [rad/s]. Timed.
  virtual surg::JointVector step(const surg::JointVector& q, const surg::JointVector& qd_last,
                                 const Goal& goal) = 0;
  std::string name;   ///< key in the results
  std::string what;   ///< one line for the reader
  long failures = 0;  ///< cycles in which a solver reported no solution
};

/// The task as every law on velocities sees it, from our kinematics: what differs is who solves it.
struct Task {
  surg::Jacobian J;
  surg::ShaftState shaft;
  surg::Vector3 v_tip;  ///< path plus feedback
  double roll_rate;     ///< omega . s
  surg::JointVector posture;
};
Task task_at(const Scene& scene, const surg::JointVector& q, const Goal& goal);

/// The same task as a quadratic programme: minimise |J_tip qd - v|^2 + w_roll (s . w - roll_rate)^2
/// + eps |qd - posture|^2, subject to J_rcm qd = k e (2 rows) and lower <= qd <= upper, the box
/// that velocity, acceleration and the position limit leave.
struct Programme {
  static constexpr double kRollWeight = 0.01;  // [m^2]: 1 rad/s of roll counts like 0.1 m/s
  static constexpr double kPostureWeight = 1e-8;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 8, 8> H;  // of 1/2 x'Hx + g'x
  surg::JointVector g, lower, upper;
  surg::RcmRows rows;
  Eigen::Vector2d b;
};
Programme programme_at(const Scene& scene, const surg::JointVector& q,
                       const surg::JointVector& qd_last, const Goal& goal);

}  // namespace bench
