// Random paths through a trocar for the tests of the limited step, what a UR5e can do of them by
// its own inverse kinematics (ur_oracle.hpp), and a run of the limited step along one.
#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "arm.hpp"
#include "surg_core/limited_step.hpp"
#include "ur_oracle.hpp"

namespace surg::test {

constexpr double kT = 0.002;  // [s] control period

/// 1 rad/s, 10 rad/s^2.
inline JointLimits slow_joints(int n, double position = 2 * M_PI) {
  JointLimits limits;
  limits.position_min = JointVector::Constant(n, -position);
  limits.position_max = JointVector::Constant(n, position);
  limits.velocity = JointVector::Constant(n, 1.0);
  limits.acceleration = JointVector::Constant(n, 10.0);
  return limits;
}

/// 0 to 1 with rest at both ends.
inline double ease(double x) {
  x = std::clamp(x, 0.0, 1.0);
  return x * x * x * (10 + x * (-15 + 6 * x));
}

/// An arm with its tool, homed on a trocar, and a path of the instrument in clock time.
struct Scene {
  Chain chain;
  Tool tool;
  JointVector q;  ///< at the beginning of the path
  Home home;
  Vector3 p_BRcm;
  double duration = 0;  ///< [s] of the clock
  std::function<ShaftGoal(double)> goal;

  ShaftGoal at(double clock) const { return goal(std::clamp(clock, 0.0, duration)); }
};

struct Reach {
  bool all = true;     ///< the branch in which the path begins has joints for all of it
  double until = 0;    ///< [s] of the clock: its end, or the last instant that can be reached
  double closest = 1;  ///< smallest singularity measure on the reachable part
};

/// Follows the path through the closed form: the branch in which it begins, joints continuous and
/// within their limits.
inline Reach reach_of(const Scene& scene, const JointLimits& limits) {
  const UrGeometry ur;
  const UrBranch branch = ur.measures(scene.q).branch();
  Reach reach;
  JointVector q = scene.q;
  const auto step = [&](double clock, JointVector& from) {
    const auto found = ur.solve(pose_on_pivot(scene.home, scene.tool, scene.at(clock)), branch);
    if (!found) return false;
    JointVector next = *found;
    for (int i = 0; i < 6; ++i) {
      next[i] = from[i] + std::remainder(next[i] - from[i], 2 * M_PI);
      if (next[i] > limits.position_max[i] || next[i] < limits.position_min[i]) return false;
    }
    reach.closest = std::min(reach.closest, ur.measures(next).closest());
    from = next;
    return true;
  };
  double clock = 0;
  while (clock < scene.duration) {
    const double coarse = std::min(0.002, scene.duration - clock);
    // Joints that turn fast are followed in finer steps, so that no turn is lost.
    double dt = coarse;
    JointVector next = q;
    bool met = step(clock + dt, next);
    while (dt > 1e-7 && (!met || (next - q).cwiseAbs().maxCoeff() > 0.3)) {
      dt *= 0.5;
      next = q;
      met = step(clock + dt, next);
    }
    if (!met) {
      reach.all = false;
      break;
    }
    q = next;
    clock += dt;
  }
  reach.until = clock;
  return reach;
}

struct Run {
  long cycles = 0;
  long violations = 0;  ///< cycles with any joint beyond velocity, acceleration or position
  double velocity = 0, acceleration = 0;  ///< largest share of the limit
  double position_margin = INFINITY;
  double rcm_sample = 0, rcm_between = 0;  ///< [m]
  std::vector<float> off_path;             ///< [m] tip to set-point, each cycle
  double off_max = 0;
  long tier1 = 0, tier2 = 0;
  bool finished = false, held = false;
  double clock = 0;
  const char* limited_by = "";
  JointVector q, qd;
};

struct RunOptions {
  double horizon = 0.45;
  double patience = 0.5;  ///< [s] of standing still that count as a stop
  double longest = 120;   ///< [s]
  double lost = 0.02;     ///< [m] off the path: give up
  std::function<void(const JointVector& q)> each;
};

/// Drives a virtual arm with the exact form along the scene's path. Everything that the limited
/// step promises is measured here, on the joint velocities that it returned.
inline Run run(const Scene& scene, const JointLimits& limits, const JointVector& qd_begin,
               const RunOptions& options = {}) {
  const LimitedStep limited(scene.chain, scene.tool, limits, kT);
  Run r;
  r.q = scene.q;
  r.qd = qd_begin;
  double still = 0;
  const long longest = std::lround(options.longest / kT);
  double last_clock = 0;
  while (r.cycles < longest) {
    const auto path = [&](double t) { return scene.at(r.clock + t); };
    Wish wish;
    wish.path = PathView(path);
    wish.horizon = options.horizon;
    const Step step = limited.exact(r.q, r.qd, scene.home, wish);
    bool inside = step.qd.allFinite();
    for (int i = 0; i < r.q.size(); ++i) {
      const double v = std::abs(step.qd[i]) / limits.velocity[i];
      const double a = std::abs(step.qd[i] - r.qd[i]) / kT / limits.acceleration[i];
      const double q = r.q[i] + kT * step.qd[i];
      const double margin = std::min(limits.position_max[i] - q, q - limits.position_min[i]);
      r.velocity = std::max(r.velocity, v);
      r.acceleration = std::max(r.acceleration, a);
      r.position_margin = std::min(r.position_margin, margin);
      inside = inside && v <= 1 + 1e-9 && a <= 1 + 1e-9 && margin >= 0;
    }
    r.violations += !inside;
    r.tier1 += step.tier == 1;
    r.tier2 += step.tier == 2;
    const JointVector middle = r.q + 0.5 * kT * step.qd;
    const JointVector next = r.q + kT * step.qd;
    const ShaftState between = shaft_state(scene.chain.forward(middle), scene.tool, scene.p_BRcm);
    const ShaftState shaft = shaft_state(scene.chain.forward(next), scene.tool, scene.p_BRcm);
    r.rcm_between = std::max(r.rcm_between, between.e.norm());
    r.rcm_sample = std::max(r.rcm_sample, shaft.e.norm());
    r.q = next;
    r.qd = step.qd;
    r.clock += step.alpha * kT;
    const double off = (shaft.p_BTip - scene.at(r.clock).p_BTip()).norm();
    r.off_path.push_back(static_cast<float>(off));
    r.off_max = std::max(r.off_max, off);
    r.limited_by = step.limited_by;
    r.held = step.held;
    ++r.cycles;
    if (options.each) options.each(r.q);
    const bool at_rest = r.qd.cwiseAbs().maxCoeff() < 1e-6;
    if (r.clock >= scene.duration - 1e-9 && off < 1e-6 && at_rest) {
      r.finished = true;
      break;
    }
    still = r.clock - last_clock < 1e-7 && r.qd.cwiseAbs().maxCoeff() < 1e-3 ? still + kT : 0;
    last_clock = r.clock;
    if (still > options.patience || off > options.lost) break;
  }
  return r;
}

}  // namespace surg::test
