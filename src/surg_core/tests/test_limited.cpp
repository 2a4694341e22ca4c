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
using test::Run;
using test::RunOptions;
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

  void add(const Run& run) {
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
Run retrace(const Scene& scene, const JointLimits& limits, const JointTrace& trace,
            const JointVector& q_begin) {
  const LimitedStep limited(scene.chain, scene.tool, limits, kT);
  Run run;
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
    RunOptions options;
    options.each = [&](const JointVector& q) { trace.record(q); };
    const Run run = test::run(scene, limits, JointVector::Zero(6), options);
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
      const Run leaving = test::run(away, limits, JointVector::Zero(6));
      tally.left += leaving.finished;
      tally.add(leaving);
      EXPECT_TRUE(leaving.finished) << "path " << i << " does not leave its hold";
    } else {
      ++tally.left;  // that target cannot be reached either; the trace can
    }
    const Run replay = retrace(scene, limits, trace, run.q);
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

}  // namespace
}  // namespace surg
