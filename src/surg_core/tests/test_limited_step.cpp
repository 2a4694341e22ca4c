// The limited step along random paths: nothing beyond a limit in any cycle, the pivot exact, every
// path that the arm's geometry allows to its end, every other one stopped and left again.
#include <chrono>

#include "support/limited_paths.hpp"
#include "support/results.hpp"

namespace surg {
namespace {

using test::cell;
using test::Course;
using test::DriveOptions;
using test::Family;
using test::kT;
using test::Random;
using test::Reach;
using test::Scene;

test::Results& results() {
  static test::Results page("limits", "src/surg_core/tests/test_limited_step.cpp",
                            "Limits: measured, at 1 rad/s and 10 rad/s^2");
  return page;
}

/// What a family of runs came to.
struct Tally {
  long paths = 0, cycles = 0, violations = 0;
  long reachable = 0, finished = 0, unreachable = 0, stopped = 0, retraced = 0;
  long targets = 0, left = 0;  // reachable ones, out of a hold
  double velocity = 0, acceleration = 0, rcm_sample = 0, rcm_between = 0;
  std::vector<float> off;

  void add(const Course& run) {
    cycles += run.cycles;
    violations += run.violations;
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

constexpr int kTargets = 4;  // reachable new ones tried out of every hold

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
    // Any reachable target leaves the hold.
    Random random(31 * i + 5);
    for (int k = 0; k < kTargets; ++k) {
      Scene away;
      const bool drawn = test::reachable_way(scene, run.q, run.clock, limits, random, away);
      EXPECT_TRUE(drawn) << "path " << i << ": no reachable target found";
      if (!drawn) break;
      const Course leaving = test::drive(away, limits, JointVector::Zero(6));
      ++tally.targets;
      tally.left += leaving.finished;
      tally.add(leaving);
      EXPECT_TRUE(leaving.finished)
          << "path " << i << " does not leave its hold for target " << k << ": stops at "
          << leaving.clock << " of " << away.duration << " s by " << leaving.limited_by;
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
                 cell("%ld", tally.violations), cell("%.1e", tally.rcm_sample * 1e6),
                 cell("%.3f", tally.rcm_between * 1e6),
                 cell("%ld of %ld", tally.finished, tally.reachable),
                 cell("%ld of %ld", tally.stopped, tally.unreachable),
                 cell("%ld of %ld", tally.left, tally.targets), cell("%ld", tally.retraced),
                 cell("%.4f / %.4f", tally.off_at(0.99) * 1e3, tally.off_at(1) * 1e3)});
}

void expect_promises(Tally& tally, double off_p99, double off_max) {
  EXPECT_EQ(tally.violations, 0);
  EXPECT_LE(tally.rcm_sample, 1e-8);
  EXPECT_LE(tally.rcm_between, 5e-7);
  EXPECT_EQ(tally.finished, tally.reachable);
  EXPECT_EQ(tally.stopped, tally.unreachable);
  EXPECT_EQ(tally.targets, kTargets * tally.unreachable);
  EXPECT_EQ(tally.left, tally.targets);
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
      "Random paths, UR5e",
      "Depth 10 to 120 mm, speed x1 to x4; usual: tilt to 65 degrees from home; harsh: random "
      "trocar, tilt to 100 degrees. The arm's closed-form inverse kinematics decide what can be "
      "reached. A path that stops gets four new targets.",
      {"family", "paths", "cycles", "beyond a limit", "RCM at samples, um", "between, um",
       "reachable finish", "unreachable stop", "new targets leave", "traces leave",
       "tip off path p99 / max, mm"});
  tabulate("usual", usual);
  tabulate("harsh", harsh);
  expect_promises(usual, 0.25e-3, 1e-3);
  expect_promises(harsh, 0.25e-3, 2e-3);
}

TEST(Limited, PathsPastASingularityFinishFromADistanceOfOneThousandth) {
  const JointLimits limits = test::slow_joints(6);
  const char* names[3] = {"shoulder", "elbow", "wrist"};
  results().table("Paths past a singularity, UR5e",
                  "All pass a singularity measure (a sine, see barrier.hpp) within 0.02 and not "
                  "within 0.001.",
                  {"singularity", "paths", "closest", "finish", "beyond a limit",
                   "RCM at samples, um", "tip off path max, mm"});
  long all = 0;
  for (int measure = 0; measure < 3; ++measure) {
    Random random(77 + measure);
    const int n = test::family(6, 40);
    Tally tally;
    double closest = 1;
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
      EXPECT_TRUE(run.finished) << names[measure] << " path " << tally.paths << " at "
                                << reach.closest << " stops at " << run.clock << " of "
                                << scene.duration << " by " << run.limited_by;
    }
    results().row({names[measure], cell("%ld", tally.paths), cell("%.4f", closest),
                   cell("%ld", tally.finished), cell("%ld", tally.violations),
                   cell("%.1e", tally.rcm_sample * 1e6), cell("%.4f", tally.off_at(1) * 1e3)});
    EXPECT_EQ(tally.finished, tally.paths);
    EXPECT_EQ(tally.violations, 0);
    EXPECT_LE(tally.rcm_sample, 1e-8);
    EXPECT_LE(tally.off_at(1), 1e-3);
    all += tally.paths;
  }
  test::report("paths past a singularity", all);
}

/// 20 mm to either side at 10 mm depth, 63 degrees, with the tool 60 mm aside and the shaft
/// vertical in the middle, beside the base at y = -0.1 m.
Scene wide_sweep(double x_trocar) {
  const test::UrGeometry ur;
  Scene scene;
  scene.chain = test::ur5e_chain();
  scene.tool = {Vector3::UnitZ(), Vector3(0.06, 0, 0.3)};
  const Vector3 z = -Vector3::UnitZ(), c(x_trocar, -0.1, 0.1);
  scene.p_BRcm = c;
  scene.home.s_B = z;
  scene.home.R_BF = Eigen::AngleAxisd(M_PI, Vector3::UnitX()).toRotationMatrix();
  const double duration = scene.duration = 2;
  scene.goal = [=](double clock) {
    const double x = 0.04 * test::ease(clock / duration) - 0.02;
    return tip_goal(c, c + 0.01 * z + x * Vector3::UnitX(), 0, z);
  };
  const auto begin = ur.solve(pose_on_pivot(scene.home, scene.tool, scene.goal(0)), {1, 1, -1});
  if (begin) scene.q = *begin;
  return scene;
}

TEST(Limited, TheWideSweepStopsWhereTheShoulderEndsAndReturns) {
  const JointLimits limits = test::slow_joints(6);
  const auto share = [](double clock) { return 100 * test::ease(clock / 2); };
  // The trocar that puts the geometric end of the sweep at 78.0 %.
  double near = 0.42, far = 0.40;
  for (int i = 0; i < 40; ++i) {
    const double mid = 0.5 * (near + far);
    (share(test::reach_of(wide_sweep(mid), limits).until) > 78.0 ? near : far) = mid;
  }
  const Scene scene = wide_sweep(far);
  const Reach reach = test::reach_of(scene, limits);
  EXPECT_NEAR(share(reach.until), 78.0, 0.05);
  const Course course = test::drive(scene, limits, JointVector::Zero(6));
  EXPECT_EQ(course.violations, 0);
  EXPECT_FALSE(course.finished);
  EXPECT_TRUE(course.held);
  EXPECT_LE(course.rcm_sample, 1e-8);
  EXPECT_LE(share(course.clock), share(reach.until) + 1e-3);
  EXPECT_GE(share(course.clock), share(reach.until) - 1.0);
  const test::UrMeasures at = test::UrGeometry().measures(course.q);
  EXPECT_LT(std::abs(at.shoulder), std::min(std::abs(at.elbow), std::abs(at.wrist)));
  const Scene back = test::way_to(scene, course.q, scene.at(0), 1.5);
  const Course home = test::drive(back, limits, JointVector::Zero(6));
  EXPECT_TRUE(home.finished);
  EXPECT_EQ(home.violations, 0);
}

TEST(Limited, F20EveryJointStopsBeforeEitherPositionLimitAndComesBack) {
  results().table("F20: position limits across each joint's way, UR5e", "",
                  {"preview", "runs", "smallest margin, rad", "beyond a limit",
                   "RCM at samples, um", "tip off path max, mm", "leave again"});
  for (const double horizon : {0.45, 0.0}) {
    Tally tally;
    double margin = INFINITY;
    const int each = test::family(1, 6);
    for (int joint = 0; joint < 6; ++joint) {
      for (const bool upper : {false, true}) {
        int done = 0;
        for (unsigned seed = 0; done < each && seed < 200; ++seed) {
          const Scene scene = test::random_scene(Family::kUsual, 5000 + seed);
          JointLimits limits = test::slow_joints(6);
          const test::UrGeometry ur;
          double furthest = 0;  // of this joint, this way
          if (!test::reach_of(scene, limits).all) continue;
          JointVector q = scene.q;
          for (double clock = 0; clock < scene.duration; clock += 0.002) {
            const auto at = ur.solve(pose_on_pivot(scene.home, scene.tool, scene.at(clock)),
                                     ur.measures(scene.q).branch());
            if (!at) break;
            q[joint] += std::remainder((*at)[joint] - q[joint], 2 * M_PI);
            furthest = std::max(furthest, (upper ? 1 : -1) * (q[joint] - scene.q[joint]));
          }
          if (furthest < 0.1) continue;
          (upper ? limits.position_max : limits.position_min)[joint] =
              scene.q[joint] + (upper ? 0.6 : -0.6) * furthest;
          DriveOptions options;
          options.horizon = horizon;
          const Course course = test::drive(scene, limits, JointVector::Zero(6), options);
          tally.add(course);
          margin = std::min(margin, course.position_margin);
          EXPECT_FALSE(course.finished);
          Random random(8 * seed + joint);
          Scene back;
          const bool drawn =
              test::reachable_way(scene, course.q, course.clock, limits, random, back);
          EXPECT_TRUE(drawn) << "joint " << joint << " seed " << seed << ": no reachable target";
          if (!drawn) continue;
          const Course inward = test::drive(back, limits, JointVector::Zero(6), options);
          EXPECT_TRUE(inward.finished)
              << "joint " << joint << (upper ? " up" : " down") << " seed " << seed;
          tally.left += inward.finished;
          margin = std::min(margin, inward.position_margin);
          tally.add(inward);
          ++tally.paths;
          ++done;
        }
        EXPECT_EQ(done, each) << "no path moves joint " << joint;
      }
    }
    results().row({horizon > 0 ? "450 ms" : "none", cell("%ld", tally.paths), cell("%.1e", margin),
                   cell("%ld", tally.violations), cell("%.1e", tally.rcm_sample * 1e6),
                   cell("%.3f", tally.off_at(1) * 1e3), cell("%ld", tally.left)});
    EXPECT_GE(margin, 0);
    EXPECT_EQ(tally.violations, 0);
    EXPECT_LE(tally.rcm_sample, 1e-8);
    EXPECT_LE(tally.off_at(1), horizon > 0 ? 1e-3 : 5e-3);
  }
}

/// A usual path for the Panda, from its home.
Scene panda_scene(unsigned seed) {
  Scene scene = test::random_scene(Family::kUsual, seed);
  const Scene like = scene;
  scene.chain = test::panda_chain();
  scene.q = test::panda_home();
  const Pose X_BF = scene.chain.forward(scene.q);
  scene.home = home_of(X_BF, scene.tool);
  const ShaftGoal first = like.goal(0);
  const Matrix3 turn = minimal_rotation(first.s_B, scene.home.s_B);
  scene.p_BRcm = X_BF * scene.tool.p_FTip - first.depth * scene.home.s_B;
  const Vector3 c = scene.p_BRcm;
  const double roll = first.roll;
  scene.goal = [=](double clock) {
    const ShaftGoal goal = like.goal(clock);
    return ShaftGoal{c, (turn * goal.s_B).normalized(), goal.depth, goal.roll - roll};
  };
  return scene;
}

TEST(Limited, PandaUnderLimits) {
  JointLimits limits = test::slow_joints(7);
  limits.position_min << -2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973;
  limits.position_max << 2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973;
  Tally tally;
  const int n = test::family(12, 300);
  for (int i = 0; i < n; ++i) {
    const Scene scene = panda_scene(9000 + i);
    const Course course = test::drive(scene, limits, JointVector::Zero(7));
    ++tally.paths;
    tally.finished += course.finished;
    tally.stopped += !course.finished && course.qd.cwiseAbs().maxCoeff() < 1e-2;
    tally.add(course);
  }
  results().table("Panda, its own position limits",
                  "The usual paths; nothing decides which of them the arm can reach.",
                  {"paths", "finish", "stop", "beyond a limit", "RCM at samples, um", "between, um",
                   "tip off path p99 / max, mm"});
  results().row({cell("%ld", tally.paths), cell("%ld", tally.finished), cell("%ld", tally.stopped),
                 cell("%ld", tally.violations), cell("%.1e", tally.rcm_sample * 1e6),
                 cell("%.3f", tally.rcm_between * 1e6),
                 cell("%.4f / %.4f", tally.off_at(0.99) * 1e3, tally.off_at(1) * 1e3)});
  EXPECT_EQ(tally.violations, 0);
  EXPECT_LE(tally.rcm_sample, 1e-8);
  EXPECT_EQ(tally.finished + tally.stopped, tally.paths);
  EXPECT_GE(tally.finished, 0.5 * n);
}

/// A joint at its velocity limit slows the path down; it does not push the tip off it.
TEST(Limited, AVelocityLimitSlowsThePathAndKeepsIt) {
  JointLimits limits = test::slow_joints(7);
  limits.velocity.setConstant(0.2);
  DriveOptions unseen;
  unseen.horizon = 0;
  for (unsigned seed = 9000; seed < 9003; ++seed) {
    const Course course = test::drive(panda_scene(seed), limits, JointVector::Zero(7), unseen);
    ASSERT_GT(course.velocity, 0.99) << "path " << seed << ": no limit binds";
    EXPECT_LT(course.off_max, 1e-8) << "path " << seed;
  }
}

/// Targets that jump: a velocity of the tip that changes at random instants without any profile.
/// The path is what a stream filter would have ruled out; the promises hold all the same.
TEST(Limited, JumpingTargetsKeepEveryLimitAndThePivot) {
  const JointLimits limits = test::slow_joints(6);
  for (const double horizon : {0.0, 0.45}) {
    Random random(4);
    Tally tally;
    const int n = test::family(20, 300);
    for (int i = 0; i < n; ++i) {
      Scene scene = test::random_scene(Family::kUsual, 7000 + i);
      const LimitedStep limited(scene.chain, scene.tool, limits, kT);
      const Vector3 z = scene.home.s_B, c = scene.p_BRcm;
      ShaftGoal now = scene.goal(0);
      Vector3 v = Vector3::Zero();
      double roll_rate = 0;
      Course course;
      course.q = scene.q;
      course.qd = JointVector::Zero(6);
      for (int cycle = 0; cycle < 1000; ++cycle) {
        if (random.integer(0, 60) == 0) {
          v = {random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2)};
          roll_rate = random.uniform(-2, 2);
        }
        const auto path = [&](double t) {
          ShaftGoal goal = tip_goal(c, now.p_BTip() + t * v, now.roll + t * roll_rate, now.s_B);
          const bool inside = goal.depth > 0.01 && goal.depth < 0.12 && goal.s_B.dot(z) > 0.5;
          return inside ? goal : now;
        };
        StepRequest request;
        request.path = PathView(path);
        request.horizon = horizon;
        const Step step = limited.exact(course.q, course.qd, scene.home, request);
        test::look(scene, limits, step, course);
        now = path(step.alpha * kT);
        const ShaftState shaft =
            shaft_state(scene.chain.forward(course.q), scene.tool, scene.p_BRcm);
        course.off_path.push_back(static_cast<float>((shaft.p_BTip - now.p_BTip()).norm()));
        course.tier1 += step.tier == 1;
        course.tier2 += step.tier == 2;
        ++course.cycles;
      }
      tally.add(course);
    }
    std::printf("preview %.0f ms: %ld cycles, tip off path p99 %.3f mm, max %.3f mm\n",
                1e3 * horizon, tally.cycles, tally.off_at(0.99) * 1e3, tally.off_at(1) * 1e3);
    EXPECT_EQ(tally.violations, 0);
    EXPECT_LE(tally.rcm_sample, 1e-8);
  }
}

/// What the follower's correction asks for may cost the path, never the reference's pivot.
TEST(Limited, TheCorrectionsRoomNeverCostsThePivot) {
  const JointLimits limits = test::slow_joints(6);
  Random random(14);
  long narrow = 0;
  const int n = test::family(20, 200);
  for (int i = 0; i < n; ++i) {
    const Scene scene = test::random_scene(Family::kUsual, 9000 + i);
    const LimitedStep limited(scene.chain, scene.tool, limits, kT);
    JointVector q = scene.q, qd = JointVector::Zero(6), room = qd;
    double clock = 0;
    for (int cycle = 0; cycle < 1000 && clock < scene.duration; ++cycle) {
      if (random.integer(0, 20) == 0) {
        for (int k = 0; k < 6; ++k) room[k] = random.uniform(-0.02, 0.02);
      }
      const auto path = [&](double t) { return scene.at(clock + 3 * t); };  // too fast for them
      StepRequest request;
      request.path = PathView(path);
      const Step free = limited.exact(q, qd, scene.home, request);
      request.room = room;
      const Step step = limited.exact(q, qd, scene.home, request);
      if (free.tier < 2) {
        narrow += (step.qd - free.qd).norm() > 1e-6;
        ASSERT_LT(step.tier, 2) << "path " << i << ", cycle " << cycle;
      }
      qd = step.qd;
      q += kT * qd;
      clock += 3 * kT * step.alpha;
    }
  }
  EXPECT_GT(narrow, 100 * n) << "the room was hardly ever in the way";
}

/// The velocity form on an ideal arm: feedback on tip, roll and pivot as the controller has it.
TEST(Limited, TheVelocityFormKeepsTheSameLimits) {
  const JointLimits limits = test::slow_joints(6);
  Tally tally;
  const int n = test::family(12, 200);
  for (int i = 0; i < n; ++i) {
    const Scene scene = test::random_scene(Family::kUsual, 11000 + i);
    if (!test::reach_of(scene, limits).all) continue;
    const LimitedStep limited(scene.chain, scene.tool, limits, kT);
    Course course;
    course.q = scene.q;
    course.qd = JointVector::Zero(6);
    for (; course.cycles < 30000 && !course.finished; ++course.cycles) {
      const ShaftState shaft = shaft_state(scene.chain.forward(course.q), scene.tool, scene.p_BRcm);
      const ShaftGoal now = scene.at(course.clock), next = scene.at(course.clock + kT);
      const double roll = absolute_roll(scene.chain.forward(course.q).linear(), scene.home.R_BF,
                                        scene.home.s_B, shaft.s);
      const Vector3 v1 = (next.p_BTip() - now.p_BTip()) / kT;
      const Vector3 v0 = 10 * (now.p_BTip() - shaft.p_BTip);
      const double k = 30;
      const auto holonomy = [&](const Vector3& v, const Vector3& e) {
        const Vector3 s_dot = (v - shaft.s * shaft.s.dot(v) - k * e) / shaft.depth;
        return roll_holonomy_rate(scene.home.s_B, shaft.s, s_dot);
      };
      StepRequest request;
      const auto path = [&](double t) { return scene.at(course.clock + t); };
      request.path = PathView(path);
      request.horizon = 0.45;
      request.feedback = rcm_twist(
          shaft, v0, 10 * std::remainder(now.roll - roll, 2 * M_PI) + holonomy(v0, shaft.e),
          Vector3::Zero(), k, 0);
      request.forward =
          rcm_twist(shaft, v1, (next.roll - now.roll) / kT + holonomy(v1, Vector3::Zero()),
                    Vector3::Zero(), 0, 0);
      const Step step = limited.velocity(course.q, course.qd, scene.home, scene.p_BRcm, request);
      test::look(scene, limits, step, course);
      course.clock += step.alpha * kT;
      course.tier1 += step.tier == 1;
      course.tier2 += step.tier == 2;
      const double off =
          (scene.chain.forward(course.q) * scene.tool.p_FTip - scene.at(course.clock).p_BTip())
              .norm();
      course.off_path.push_back(static_cast<float>(off));
      course.finished = course.clock >= scene.duration && off < 1e-4;
    }
    ++tally.paths;
    tally.finished += course.finished;
    tally.add(course);
    EXPECT_TRUE(course.finished) << "path " << i << " at " << course.clock << " of "
                                 << scene.duration << " by " << course.limited_by;
  }
  EXPECT_EQ(tally.violations, 0);
  EXPECT_LE(tally.rcm_sample, 5e-5);
}

/// Printed, not judged: a shared machine has no wall-clock to speak of.
TEST(Limited, Cost) {
  const JointLimits limits = test::slow_joints(6);
  for (const double horizon : {0.0, 0.45}) {
    std::vector<double> microseconds;
    for (int i = 0; i < test::family(6, 20); ++i) {
      const Scene scene = test::random_scene(Family::kUsual, i);
      const LimitedStep limited(scene.chain, scene.tool, limits, kT);
      JointVector q = scene.q, qd = JointVector::Zero(6);
      double clock = 0;
      for (int cycle = 0; cycle < 1500; ++cycle) {
        const auto path = [&](double t) { return scene.at(clock + t); };
        StepRequest request;
        request.path = PathView(path);
        request.horizon = horizon;
        const auto begin = std::chrono::steady_clock::now();
        const Step step = limited.exact(q, qd, scene.home, request);
        const std::chrono::duration<double, std::micro> took =
            std::chrono::steady_clock::now() - begin;
        microseconds.push_back(took.count());
        q += kT * step.qd;
        qd = step.qd;
        clock += step.alpha * kT;
      }
    }
    std::sort(microseconds.begin(), microseconds.end());
    std::printf("preview %.0f ms: median %.2f us, p99 %.2f us\n", 1e3 * horizon,
                microseconds[microseconds.size() / 2],
                microseconds[microseconds.size() * 99 / 100]);
  }
}

TEST(Limited, LeavesTheHeapAlone) {
  const JointLimits limits = test::slow_joints(6);
  const Scene scene = test::random_scene(Family::kUsual, 1);
  const LimitedStep limited(scene.chain, scene.tool, limits, kT);
  JointTrace trace;
  JointVector q = scene.q, qd = JointVector::Zero(6);
  double clock = 0;
  const auto path = [&](double t) { return scene.at(clock + t); };
  long calls = 0;
  {
    test::HeapWatch watch;
    for (int cycle = 0; cycle < 500; ++cycle) {
      StepRequest request;
      request.path = PathView(path);
      request.horizon = 0.45;
      if (cycle % 100 == 50) qd.setConstant(0.5);  // other tiers as well
      const Step step = cycle < 400 ? limited.exact(q, qd, scene.home, request)
                                    : limited.retrace(q, qd, trace, 0, 0.5, scene.p_BRcm);
      q += kT * step.qd;
      qd = step.qd;
      clock += step.alpha * kT;
      trace.record(q);
      limited.velocity(q, qd, scene.home, scene.p_BRcm, request);
    }
    calls = watch.calls();
  }
  EXPECT_EQ(SURG_HEAP_IS_WATCHED ? calls : 0, 0);
}

}  // namespace
}  // namespace surg
