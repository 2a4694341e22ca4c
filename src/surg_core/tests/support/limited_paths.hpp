// Random paths through a trocar for the tests of the limited step, what a UR5e can do of them by
// its own inverse kinematics (ur_oracle.hpp), and a run of the limited step along one. Include it
// in one file per test program only (support.hpp).
#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "surg_core/limits/limited_step.hpp"
#include "test_arm.hpp"
#include "test_support.hpp"
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

/// Time of a motion at unit speed that ramps up from rest and down to it within 'duration'.
inline double with_ramps(double clock, double duration) {
  const double ramp = 0.15 * duration;
  const auto integral = [](double x) {
    x = std::clamp(x, 0.0, 1.0);
    return x * x * x * x * (2.5 + x * (-3 + x));
  };
  const double up = ramp * integral(clock / ramp);
  const double level = std::clamp(clock - ramp, 0.0, duration - 2 * ramp);
  const double rest = duration - clock;
  const double down = rest < ramp ? ramp * (0.5 - integral(rest / ramp)) : 0.0;
  return up + level + down;
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

/// Direction tilted from 'z' by the angle |(a, b)| towards a u + b w.
inline Vector3 tilted(const Vector3& z, const Vector3& u, double a, double b) {
  const Vector3 axis = z.cross(Vector3(a * u + b * z.cross(u)));
  const double angle = axis.norm();
  if (angle < 1e-12) return z;
  return (Eigen::AngleAxisd(angle, axis / angle) * z).normalized();
}

enum class Family {
  kUsual,  ///< the shipped home, tilt to 65 degrees
  kHarsh,  ///< random trocar, tool tilted by 10 degrees, tilt to 100 degrees
};

/// A smooth random path of about six seconds at speed 1, sped up by 1 to 4: depth 10 to 120 mm,
/// tool offset 0 or 60 mm, roll within 46 degrees. Half of the paths wander in tilt and depth, half
/// in a plane square to the home axis. It begins where the arm has joints, not next to a
/// singularity; whether the rest can be reached is nobody's care here.
inline Scene random_scene(Family family, unsigned seed) {
  Random random(1000003u * (family == Family::kUsual ? 1 : 2) + seed);
  const UrGeometry ur;
  for (;;) {
    Scene scene;
    scene.chain = ur5e_chain();
    const double offset = random.integer(0, 1) ? 0.06 : 0.0;
    scene.tool = {Vector3::UnitZ(), Vector3(offset, 0, 0.3)};
    JointVector q = ur5e_home();
    double tilt_max = 65 * M_PI / 180;
    if (family == Family::kHarsh) {
      const double around = random.uniform(-M_PI, M_PI), tilt = 10 * M_PI / 180;
      scene.tool.s_F = {std::sin(tilt) * std::cos(around), std::sin(tilt) * std::sin(around),
                        std::cos(tilt)};
      scene.tool.p_FTip = Vector3(offset, 0, 0) + 0.3 * scene.tool.s_F;
      tilt_max = 100 * M_PI / 180;
      for (int i = 0; i < 6; ++i) q[i] += random.uniform(-0.5, 0.5);
    }
    const Pose X_BF = scene.chain.forward(q);
    scene.home = home_of(X_BF, scene.tool);
    const Vector3 z = scene.home.s_B;
    scene.p_BRcm = X_BF * scene.tool.p_FTip - random.uniform(0.02, 0.12) * z;
    const double speed = random.uniform(1, 4);
    const double tilt = random.uniform(0, tilt_max), mix = random.uniform(0, 1);
    const double roll = random.uniform(0, 0.8), around = random.uniform(0, 2 * M_PI);
    double shallow = random.uniform(0.01, 0.12), deep = random.uniform(0.01, 0.12);
    if (shallow > deep) std::swap(shallow, deep);
    const bool plane = random.integer(0, 1) && tilt < 1.2;
    if (plane) {
      deep = std::max(0.01, 0.12 * std::cos(tilt));
      shallow = std::min(shallow, deep);
    }
    std::array<double, 3> f, phase;
    for (int i = 0; i < 3; ++i) {
      f[i] = 2 * M_PI * random.uniform(0.1, 0.3);
      phase[i] = random.uniform(0, 2 * M_PI);
    }
    Vector3 u = z.unitOrthogonal();
    u = Eigen::AngleAxisd(around, z) * u;
    const Vector3 w = z.cross(u), c = scene.p_BRcm;
    const double duration = scene.duration = 6 / speed;
    scene.goal = [=](double clock) {
      const double x = speed * with_ramps(clock, duration);
      const double scale = tilt / std::hypot(1.0, mix);
      const double a = scale * std::sin(f[0] * x + phase[0]);
      const double b = scale * mix * std::sin(f[1] * x + phase[1]);
      const double depth = shallow + (deep - shallow) * (0.5 + 0.5 * std::sin(f[2] * x + phase[2]));
      const double psi = roll * std::sin(f[1] * x);
      if (!plane) return ShaftGoal{c, tilted(z, u, a, b), depth, psi};
      const double wide = tilt > 0 ? std::tan(tilt) / tilt : 1.0;
      return tip_goal(c, c + depth * (z + wide * (a * u + b * w)), psi, z);
    };
    const auto begin =
        ur.solve(pose_on_pivot(scene.home, scene.tool, scene.goal(0)), ur.measures(q).branch());
    if (!begin) continue;
    scene.q = *begin;
    for (int i = 0; i < 6; ++i) scene.q[i] = q[i] + std::remainder(scene.q[i] - q[i], 2 * M_PI);
    if (ur.measures(scene.q).closest() < 0.03) continue;
    if (scene.q.cwiseAbs().maxCoeff() > 2 * M_PI) continue;
    return scene;
  }
}

/// A path that passes one singularity measure (0 shoulder, 1 elbow, 2 wrist) closely: through a
/// configuration where the measure is 'distance', in a random direction, bent so that it may turn
/// back. Where the arm has joints for its beginning; the rest is for 'reach_of' to say.
inline bool singular_scene(int measure, double distance, Random& random, Scene& scene) {
  const UrGeometry ur;
  scene = Scene();
  scene.chain = ur5e_chain();
  scene.tool = {Vector3::UnitZ(), Vector3(random.integer(0, 1) ? 0.06 : 0.0, 0, 0.3)};
  JointVector q = ur5e_home();
  for (int i = 0; i < 6; ++i) q[i] += random.uniform(-0.4, 0.4);
  const double angle = (random.integer(0, 1) ? 1 : -1) * std::asin(distance);
  if (measure == 1) q[2] = angle;
  if (measure == 2) q[4] = angle;
  if (measure == 0) {  // lift the arm until the wrist centre is nearly above axis 1
    const auto off = [&](double q2) {
      JointVector at = q;
      at[1] = q2;
      return ur.measures(at).shoulder - std::sin(angle);
    };
    double low = q[1] - 2.5, high = q[1];
    if (off(low) * off(high) > 0) return false;
    for (int i = 0; i < 60; ++i) {
      const double mid = 0.5 * (low + high);
      (off(low) * off(mid) <= 0 ? high : low) = mid;
    }
    q[1] = low;
  }
  if (std::abs(ur.measures(q).closest() - distance) > 1e-6) return false;
  const Pose X_BF = scene.chain.forward(q);
  scene.home = home_of(X_BF, scene.tool);
  const double depth = random.uniform(0.04, 0.1);
  const Vector3 z = scene.home.s_B, u = z.unitOrthogonal();
  const Vector3 c = scene.p_BRcm = X_BF * scene.tool.p_FTip - depth * z;
  const auto any = [&](double size) { return random.uniform(-size, size); };
  const Vector3 along(any(0.4), any(0.4), any(0.03)), bent(any(0.4), any(0.4), any(0.03));
  const double turn = any(0.4);
  const double duration = scene.duration = random.uniform(1.5, 4);
  scene.goal = [=](double clock) {
    const double x = 2 * ease(clock / duration) - 1;
    const Vector3 at = x * along + x * x * bent;
    return ShaftGoal{c, tilted(z, u, at[0], at[1]), depth + at[2], turn * x};
  };
  const auto begin =
      ur.solve(pose_on_pivot(scene.home, scene.tool, scene.goal(0)), ur.measures(q).branch());
  if (!begin) return false;
  scene.q = *begin;
  for (int i = 0; i < 6; ++i) scene.q[i] = q[i] + std::remainder(scene.q[i] - q[i], 2 * M_PI);
  return scene.q.cwiseAbs().maxCoeff() < 2 * M_PI;
}

/// From where the arm stands to a goal, straight in tilt, depth and roll, at rest at both ends.
inline Scene way_to(const Scene& scene, const JointVector& q, const ShaftGoal& goal,
                    double duration) {
  Scene way = scene;
  way.q = q;
  way.duration = duration;
  const Pose X_BF = scene.chain.forward(q);
  const ShaftState shaft = shaft_state(X_BF, scene.tool, scene.p_BRcm);
  const double turn = absolute_roll(X_BF.linear(), scene.home.R_BF, scene.home.s_B, shaft.s);
  const ShaftGoal from{scene.p_BRcm, shaft.s, shaft.depth,
                       goal.roll + std::remainder(turn - goal.roll, 2 * M_PI)};
  const Vector3 axis = from.s_B.cross(goal.s_B);
  const double angle = std::atan2(axis.norm(), from.s_B.dot(goal.s_B));
  way.goal = [=](double at) {
    const double x = ease(at / duration);
    ShaftGoal now = from;
    if (angle > 1e-9) now.s_B = Eigen::AngleAxisd(x * angle, axis.normalized()) * from.s_B;
    now.depth += x * (goal.depth - from.depth);
    now.roll += x * (goal.roll - from.roll);
    return now;
  };
  return way;
}

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
    // Fine next to a singularity, where the measure has its dips.
    const double spacing = ur.measures(q).closest() < 0.05 ? 5e-5 : 0.002;
    const double coarse = std::min(spacing, scene.duration - clock);
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

/// A way from where the arm is held, at 'clock' of its path, to a new target: drawn until the
/// inverse kinematics reaches all of it. Half of the draws lie on the path behind, half anywhere
/// within 65 degrees of home, 10 to 120 mm deep.
inline bool reachable_way(const Scene& scene, const JointVector& q, double clock,
                          const JointLimits& limits, Random& random, Scene& way) {
  for (int draw = 0; draw < 100; ++draw) {
    ShaftGoal goal = scene.at(random.uniform(0, clock));
    if (draw % 2 == 1) {
      const double tilt = random.uniform(0, 65 * M_PI / 180), to = random.uniform(0, 2 * M_PI);
      const Vector3 z = scene.home.s_B;
      goal.s_B = tilted(z, z.unitOrthogonal(), tilt * std::cos(to), tilt * std::sin(to));
      goal.depth = random.uniform(0.01, 0.12);
      goal.roll = random.uniform(-0.8, 0.8);
    }
    way = way_to(scene, q, goal, 1.5);
    if (reach_of(way, limits).all) return true;
  }
  return false;
}

struct Course {
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

struct DriveOptions {
  double horizon = 0.45;
  double patience = 0.5;  ///< [s] of standing still that count as a stop
  double longest = 120;   ///< [s]
  double lost = 0.02;     ///< [m] off the path: give up
  std::function<void(const JointVector& q)> each;
};

/// Moves the virtual arm by one step and measures what the limited step promises, on the joint
/// velocities that it returned.
inline void look(const Scene& scene, const JointLimits& limits, const Step& step, Course& r) {
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
  r.limited_by = step.limited_by;
  r.held = step.held;
}

/// Drives a virtual arm with the exact form along the scene's path. Everything that the limited
/// step promises is measured here, on the joint velocities that it returned.
inline Course drive(const Scene& scene, const JointLimits& limits, const JointVector& qd_begin,
                    const DriveOptions& options = {}) {
  const LimitedStep limited(scene.chain, scene.tool, limits, kT);
  Course r;
  r.q = scene.q;
  r.qd = qd_begin;
  double still = 0;
  const long longest = std::lround(options.longest / kT);
  double last_clock = 0;
  while (r.cycles < longest) {
    const auto path = [&](double t) { return scene.at(r.clock + t); };
    StepRequest request;
    request.path = PathView(path);
    request.horizon = options.horizon;
    if (r.q.size() > 6) request.posture = scene.q - r.q;  // 1 /s
    const Step step = limited.exact(r.q, r.qd, scene.home, request);
    look(scene, limits, step, r);
    const ShaftState shaft = shaft_state(scene.chain.forward(r.q), scene.tool, scene.p_BRcm);
    r.clock += step.alpha * kT;
    const double off = (shaft.p_BTip - scene.at(r.clock).p_BTip()).norm();
    r.off_path.push_back(static_cast<float>(off));
    r.off_max = std::max(r.off_max, off);
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
