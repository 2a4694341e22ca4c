// The limited step along random paths: nothing beyond a limit in any cycle, the pivot exact, every
// path that the arm's geometry allows to its end, every other one stopped and left again.
#include <chrono>

#include "limited_paths.hpp"
#include "results.hpp"

namespace surg {
namespace {

using test::cell;
using test::Family;
using test::kT;
using test::Random;
using test::Reach;
using test::Course;
using test::DriveOptions;
using test::Scene;

test::Results& results() {
  static test::Results page("limits", "test_limited", "Limits: measured");
  return page;
}

/// What a family of runs came to.
struct Tally {
  long paths = 0, cycles = 0, violations = 0, tier1 = 0, tier2 = 0;
  long reachable = 0, finished = 0, unreachable = 0, stopped = 0, left = 0, retraced = 0;
  double velocity = 0, acceleration = 0, rcm_sample = 0, rcm_between = 0;
  std::vector<float> off;

  void add(const Course& run) {
    cycles += run.cycles;
    violations += run.violations;
    tier1 += run.tier1;
    tier2 += run.tier2;
    velocity = std::max(velocity, run.velocity);
    acceleration = std::max(acceleration, run.acceleration);
    rcm_sample = std::max(rcm_sample, run.rcm_sample);
    rcm_between = std::max(rcm_between, run.rcm_between);
    off.insert(off.end(), run.off_path.begin(), run.off_path.end());
  }
  double off_at(double share) {
    if (off.empty()) return 0;
    const auto at = off.begin() + static_cast<long>(share * (off.size() - 1));
    std::nth_element(off.begin(), at, off.end());
    return *at;
  }
};

/// Backwards along the trace until its beginning.
Course retrace(const Scene& scene, const JointLimits& limits, const JointTrace& trace,
            const JointVector& q_begin) {
  const LimitedStep limited(scene.chain, scene.tool, limits, kT);
  Course run;
  run.q = q_begin;
  run.qd = JointVector::Zero(q_begin.size());
  double back = 0;
  const double rate = 0.5;
  const long longest = std::lround((trace.length() / rate * 6 + 20) / kT);
  for (; run.cycles < longest; ++run.cycles) {
    const Step step = limited.retrace(run.q, run.qd, trace, back, rate, scene.p_BRcm);
    test::look(scene, limits, step, run);
    back += step.alpha * rate * kT;
    if (back >= trace.length() && run.qd.cwiseAbs().maxCoeff() < 1e-6 &&
        (run.q - trace.at(trace.length())).cwiseAbs().maxCoeff() < 1e-4) {
      run.finished = true;
      break;
    }
  }
  return run;
}

Tally drive_family(Family family, int n) {
  Tally tally;
  const JointLimits limits = test::slow_joints(6);
  for (int i = 0; i < n; ++i) {
    const Scene scene = test::random_scene(family, i);
    const Reach reach = test::reach_of(scene, limits);
    JointTrace trace;
    DriveOptions options;
    options.each = [&](const JointVector& q) { trace.record(q); };
    const Course run = test::drive(scene, limits, JointVector::Zero(6), options);
    ++tally.paths;
    tally.add(run);
    if (reach.all) {
      ++tally.reachable;
      tally.finished += run.finished;
      EXPECT_TRUE(run.finished) << "path " << i << " stops at " << run.clock << " of "
                                << scene.duration << " s by " << run.limited_by;
      continue;
    }
    ++tally.unreachable;
    const bool stopped =
        !run.finished && run.clock <= reach.until + 1e-3 && run.qd.cwiseAbs().maxCoeff() < 1e-2;
    tally.stopped += stopped;
    EXPECT_TRUE(stopped) << "path " << i << " at " << run.clock << ", its end is " << reach.until;
    EXPECT_TRUE(run.held) << "path " << i;
    // Any reachable target leaves the hold: half of the way back, straight in tilt and depth.
    const Scene away = test::way_back(scene, run.q, run.clock, 0.5 * run.clock, 1.5);
    if (test::reach_of(away, limits).all) {
      const Course leaving = test::drive(away, limits, JointVector::Zero(6));
      tally.left += leaving.finished;
      tally.add(leaving);
      EXPECT_TRUE(leaving.finished) << "path " << i << " does not leave its hold";
    } else {
      ++tally.left;  // that target cannot be reached either; the trace can
    }
    const Course replay = retrace(scene, limits, trace, run.q);
    tally.retraced += replay.finished;
    tally.add(replay);
    EXPECT_TRUE(replay.finished) << "path " << i << " does not retrace";
  }
  return tally;
}

void tabulate(const char* name, Tally& tally) {
  results().row({name, cell("%ld", tally.paths), cell("%ld", tally.cycles),
                 cell("%ld", tally.violations), cell("%.9f", tally.velocity),
                 cell("%.9f", tally.acceleration), cell("%.1e", tally.rcm_sample * 1e6),
                 cell("%.3f", tally.rcm_between * 1e6),
                 cell("%ld of %ld", tally.finished, tally.reachable),
                 cell("%ld of %ld", tally.stopped, tally.unreachable),
                 cell("%ld, %ld", tally.left, tally.retraced),
                 cell("%.4f / %.4f", tally.off_at(0.99) * 1e3, tally.off_at(1) * 1e3),
                 cell("%ld, %ld", tally.tier1, tally.tier2)});
}

void expect_promises(Tally& tally, double off_p99, double off_max) {
  EXPECT_EQ(tally.violations, 0);
  EXPECT_LE(tally.rcm_sample, 1e-8);
  EXPECT_LE(tally.rcm_between, 5e-7);
  EXPECT_EQ(tally.finished, tally.reachable);
  EXPECT_EQ(tally.stopped, tally.unreachable);
  EXPECT_EQ(tally.left, tally.unreachable);
  EXPECT_EQ(tally.retraced, tally.unreachable);
  EXPECT_LE(tally.off_at(0.99), off_p99);
  EXPECT_LE(tally.off_at(1), off_max);
  test::report("paths", tally.paths);
  test::report("cycles", tally.cycles);
}

TEST(Limited, TwoThousandPathsKeepEveryLimitAndThePivot) {
  const int n = test::family(50, 1000);
  Tally usual = drive_family(Family::kUsual, n), harsh = drive_family(Family::kHarsh, n);
  results().table(
      "Random paths, UR5e, 1 rad/s and 10 rad/s^2",
      "Depth 10 to 120 mm, tool offset 0 or 60 mm, speed x1 to x4; usual: tilt to 65 degrees from "
      "the shipped home; harsh: random trocar, tool tilted by 10 degrees, tilt to 100 degrees. "
      "Limits are checked in every cycle on the joint velocities sent. What can be reached is "
      "decided by the arm's closed-form inverse kinematics, written for the test.",
      {"family", "paths", "cycles", "cycles beyond a limit", "largest speed / limit",
       "largest acceleration / limit", "RCM at samples, um", "RCM between, um", "reachable finish",
       "unreachable stop", "leave by a new target, by the trace", "tip off path p99 / max, mm",
       "cycles in tier 1, 2"});
  tabulate("usual", usual);
  tabulate("harsh", harsh);
  expect_promises(usual, 0.25e-3, 1e-3);
  expect_promises(harsh, 0.25e-3, 2e-3);
}

TEST(Limited, PathsPastASingularityFinishFromADistanceOfOneThousandth) {
  const JointLimits limits = test::slow_joints(6);
  const char* names[3] = {"shoulder", "elbow", "wrist"};
  results().table("Paths past a singularity, UR5e",
                  "All pass a singularity measure of the arm (a sine, see barrier.hpp) within 0.02 "
                  "and not within 0.001, in one branch of the inverse kinematics.",
                  {"singularity", "paths", "closest", "finish", "cycles beyond a limit",
                   "RCM at samples, um", "tip off path max, mm", "longest, s for s of the clock"});
  long all = 0;
  for (int measure = 0; measure < 3; ++measure) {
    Random random(77 + measure);
    const int n = test::family(6, 40);
    Tally tally;
    double closest = 1, slowest = 0;
    while (tally.paths < n) {
      Scene scene;
      if (!test::singular_scene(measure, random.magnitude(0.001, 0.02), random, scene)) continue;
      const Reach reach = test::reach_of(scene, limits);
      if (!reach.all || reach.closest < 0.001 || reach.closest > 0.02) continue;
      const Course run = test::drive(scene, limits, JointVector::Zero(6));
      ++tally.paths;
      tally.finished += run.finished;
      tally.add(run);
      closest = std::min(closest, reach.closest);
      slowest = std::max(slowest, run.cycles * kT / scene.duration);
      EXPECT_TRUE(run.finished) << names[measure] << " path " << tally.paths << " at "
                                << reach.closest << " stops at " << run.clock << " of "
                                << scene.duration << " by " << run.limited_by;
    }
    results().row({names[measure], cell("%ld", tally.paths), cell("%.4f", closest),
                   cell("%ld", tally.finished), cell("%ld", tally.violations),
                   cell("%.1e", tally.rcm_sample * 1e6), cell("%.4f", tally.off_at(1) * 1e3),
                   cell("%.1f", slowest)});
    EXPECT_EQ(tally.finished, tally.paths);
    EXPECT_EQ(tally.violations, 0);
    EXPECT_LE(tally.rcm_sample, 1e-8);
    EXPECT_LE(tally.off_at(1), 1e-3);
    all += tally.paths;
  }
  test::report("paths past a singularity", all);
}

/// 20 mm to either side at 10 mm depth with the tool 60 mm aside, the shaft vertical at the middle.
Scene wide_sweep(double x_trocar) {
  const test::UrGeometry ur;
  Scene scene;
  scene.chain = test::ur5e_chain();
  scene.tool = {Vector3::UnitZ(), Vector3(0.06, 0, 0.3)};
  const Vector3 z = -Vector3::UnitZ();
  scene.p_BRcm = Vector3(x_trocar, -0.13, 0.1);
  Pose X_BF = Pose::Identity();
  X_BF.linear().col(0) = Vector3::UnitX();
  X_BF.linear().col(1) = -Vector3::UnitY();
  X_BF.linear().col(2) = z;
  scene.home = {z, X_BF.linear()};
  const Vector3 c = scene.p_BRcm;
  const double duration = scene.duration = 2;
  // To the far side first, then to the arm's own.
  scene.goal = [=](double clock) {
    const double x = 0.02 - 0.04 * test::ease(clock / duration);
    return tip_goal(c, c + 0.01 * z + x * Vector3::UnitX(), 0, z);
  };
  const auto begin = ur.solve(pose_on_pivot(scene.home, scene.tool, scene.goal(0)), {1, 1, -1});
  if (begin) scene.q = *begin;
  return scene;
}

}  // namespace
}  // namespace surg
