// The parts of the limited step by themselves: recorded trace, singularity measures, position
// braking, and what happens at the edges.
#include "support/limited_paths.hpp"
#include "support/test_support.hpp"

namespace surg {
namespace {

using test::kT;
using test::Random;

JointVector wave(double t) {
  JointVector q(6);
  for (int i = 0; i < 6; ++i) q[i] = std::sin((0.3 + 0.1 * i) * t + i);
  return q;
}

TEST(JointTrace, GivesBackWhatWasRecordedInBoundedMemory) {
  JointTrace trace;
  EXPECT_TRUE(trace.empty());
  EXPECT_EQ(trace.length(), 0);
  double length = 0;
  const double seconds = 100;
  for (double t = 0; t < seconds; t += kT) {
    trace.record(wave(t));
    if (t > 0) length += (wave(t) - wave(t - kT)).cwiseAbs().maxCoeff();
  }
  EXPECT_LE(trace.size(), JointTrace::kCapacity);
  EXPECT_GT(trace.size(), JointTrace::kCapacity / 4);
  EXPECT_GT(trace.length(), 1);
  EXPECT_LE(trace.length(), length * (1 + 1e-9));
  EXPECT_LT((trace.at(0) - wave(seconds)).norm(), 5e-3);
  EXPECT_LT((trace.at(trace.length()) - wave(0)).norm(), 1e-12) << "the first point is the way out";
  EXPECT_LT((trace.at(1e9) - wave(0)).norm(), 1e-12);
  // Everywhere next to where the joints have been.
  double worst = 0;
  for (double s = 0; s < trace.length(); s += 0.5) {
    const JointVector q = trace.at(s);
    double nearest = INFINITY;
    for (double t = 0; t < seconds; t += 0.02) {
      nearest = std::min(nearest, (wave(t) - q).cwiseAbs().maxCoeff());
    }
    worst = std::max(worst, nearest);
  }
  EXPECT_LT(worst, 0.05);
  test::report("recorded cycles", std::lround(seconds / kT));
}

TEST(JointTrace, LoopsAreNoPartOfTheWayOut) {
  JointTrace trace;
  const auto work = [](double t) {  // goes in for 2 s, then round and round for an hour
    JointVector q = JointVector::Constant(6, 0.2 * std::min(t, 2.0));
    q[1] += 0.1 * std::sin(0.7 * std::max(t - 2, 0.0));
    q[3] += 0.1 * std::sin(1.4 * std::max(t - 2, 0.0));
    return q;
  };
  const double seconds = test::family(200, 3600);
  for (double t = 0; t < seconds; t += kT) trace.record(work(t));
  EXPECT_LT(trace.length(), 0.4 + 1.0) << "the way in and one round at most";
  EXPECT_LT((trace.at(trace.length()) - work(0)).norm(), 1e-12);
  double gap = 0;
  for (double s = 0; s < trace.length(); s += 1e-3) {
    gap = std::max(gap, (trace.at(s + 1e-3) - trace.at(s)).cwiseAbs().maxCoeff());
  }
  EXPECT_LT(gap, 5e-3) << "a jump where a loop was cut";
}

TEST(JointTrace, IsContinuousWithItsSlope) {
  JointTrace trace;
  for (double t = 0; t < 20; t += kT) trace.record(wave(t));
  const double h = 1e-4;
  double step = 0, bend = 0;
  for (double s = h; s < trace.length() - h; s += 7e-4) {
    const JointVector a = trace.at(s - h), b = trace.at(s), c = trace.at(s + h);
    step = std::max(step, (c - b).cwiseAbs().maxCoeff() / h);
    bend = std::max(bend, (a - 2 * b + c).cwiseAbs().maxCoeff() / h);
  }
  EXPECT_LT(step, 1.3);
  EXPECT_LT(bend, 0.05) << "a corner";
}

TEST(JointTrace, ShortenedItEndsWhereItHasGoneBackTo) {
  Random random(3);
  const int n = test::family(300, 10000);
  for (int run = 0; run < n; ++run) {
    JointTrace whole;
    const double seconds = random.uniform(0, 20);
    for (double t = 0; t <= seconds; t += kT) whole.record(wave(t));
    const double length = whole.length();
    const double s = run % 10 == 0 ? length : random.uniform(-0.1, 1.1) * length;
    const double gone = std::clamp(s, 0.0, length);
    JointTrace trace = whole;
    trace.shorten(s);
    ASSERT_FALSE(trace.empty());
    ASSERT_LT((trace.at(0) - whole.at(gone)).norm(), 1e-9);
    ASSERT_LT((trace.at(1e9) - wave(0)).norm(), 1e-12);
    // The arc to a point between two counts its largest joint's way, the curve's own is another.
    ASSERT_NEAR(trace.length(), length - gone, 2 * JointTrace::kSpacing);
    // From there it goes on like any other.
    trace.record(whole.at(gone));
    ASSERT_LT((trace.at(0) - whole.at(gone)).norm(), 1e-9);
  }
  JointTrace none;
  none.shorten(1);
  EXPECT_TRUE(none.empty());
  test::report("shortened traces", n);
}

TEST(JointTrace, OfAnArmThatStoodStillIsAPoint) {
  JointTrace trace;
  const JointVector q = wave(1);
  for (int i = 0; i < 1000; ++i) trace.record(q);
  EXPECT_EQ(trace.size(), 1);
  EXPECT_EQ(trace.length(), 0);
  EXPECT_LT((trace.at(0.3) - q).norm(), 1e-15);
  trace.clear();
  EXPECT_TRUE(trace.empty());
}

TEST(Barrier, MeasuresAreThoseOfTheArmsGeometry) {
  const Chain chain = test::ur5e_chain();
  const Barrier barrier(chain);
  ASSERT_TRUE(barrier.like_ur());
  Random random(1);
  const test::UrGeometry ur;
  const int n = test::family(2000, 100000);
  for (int i = 0; i < n; ++i) {
    JointVector q(6);
    for (int k = 0; k < 6; ++k) q[k] = random.uniform(-3, 3);
    const auto [X_BF, J] = chain.flange(q);
    const SingularityMeasures found = barrier.measures(X_BF, J);
    const test::UrMeasures expected = ur.measures(q);
    ASSERT_EQ(found.n, 3);
    EXPECT_NEAR(std::abs(found.phi[0]), std::abs(expected.shoulder), 1e-9);
    EXPECT_NEAR(found.phi[1], expected.elbow, 1e-9);
    EXPECT_NEAR(found.phi[2], expected.wrist, 1e-9);
  }
  test::report("random configurations", n);
}

TEST(Barrier, OtherArmsHaveOneMeasureThatVanishesWithTheRank) {
  const Chain panda = test::panda_chain();
  const Barrier barrier(panda);
  EXPECT_FALSE(barrier.like_ur());
  auto [X_BF, J] = panda.flange(test::panda_home());
  EXPECT_GT(barrier.measures(X_BF, J).phi[0], 0.01);
  panda.forward(JointVector::Zero(7), X_BF, J);  // stretched out
  EXPECT_LT(barrier.measures(X_BF, J).phi[0], 1e-6);
  EXPECT_EQ(barrier.fastest_approach(0), 0);
  EXPECT_GT(barrier.fastest_approach(0.1), barrier.fastest_approach(0.01));
}

/// Away from a singularity alpha is what the joints allow, and the barrier has no word in it.
TEST(Limited, MotionAwayFromASingularityIsNeverLimitedByIt) {
  Random random(3);
  const JointLimits limits = test::slow_joints(6);
  int looked = 0;
  const int n = test::family(30, 1000);
  while (looked < n) {
    test::Scene scene;
    if (!test::singular_scene(looked % 3, 0.002, random, scene)) continue;
    // Begins at the closest point: the second half of the path, entered at rest.
    const test::UrGeometry ur;
    const ShaftGoal middle = scene.goal(0.5 * scene.duration);
    const auto q =
        ur.solve(pose_on_pivot(scene.home, scene.tool, middle), ur.measures(scene.q).branch());
    if (!q) continue;
    const LimitedStep limited(scene.chain, scene.tool, limits, kT);
    const double begin = 0.5 * scene.duration;
    for (const int way : {1, -1}) {
      const auto path = [&](double t) { return scene.at(begin + way * 0.02 * t); };
      StepRequest request;
      request.path = PathView(path);
      const auto next =
          ur.solve(pose_on_pivot(scene.home, scene.tool, path(kT)), ur.measures(*q).branch());
      if (!next) continue;
      if (ur.measures(*next).closest() <= ur.measures(*q).closest()) continue;
      const Step step = limited.exact(*q, JointVector::Zero(6), scene.home, request);
      EXPECT_STRNE(step.limited_by, "singularity");
      EXPECT_GT(step.alpha, 0);
      ++looked;
    }
  }
  test::report("motions away", looked);
}

TEST(Limited, ArmThatStandsBeyondALimitComesInwardsOnly) {
  const test::Scene scene = test::random_scene(test::Family::kUsual, 3);
  for (int joint = 0; joint < 6; ++joint) {
    for (const double side : {1.0, -1.0}) {
      JointLimits limits = test::slow_joints(6);
      (side > 0 ? limits.position_max : limits.position_min)[joint] =
          scene.q[joint] - side * 0.01;  // 10 mrad outside
      const LimitedStep limited(scene.chain, scene.tool, limits, kT);
      JointVector q = scene.q, qd = JointVector::Zero(6);
      double clock = 0;
      for (int cycle = 0; cycle < 400; ++cycle) {
        const auto path = [&](double t) { return scene.at(clock + t); };
        StepRequest request;
        request.path = PathView(path);
        const Step step = limited.exact(q, qd, scene.home, request);
        ASSERT_TRUE(step.qd.allFinite());
        EXPECT_LE(side * step.qd[joint], 1e-12) << "joint " << joint;
        if ((q[joint] - scene.q[joint]) * side < -0.01) break;
        q += kT * step.qd;
        qd = step.qd;
        clock += step.alpha * kT;
      }
    }
  }
}

TEST(Limited, NothingToDoIsNothingDone) {
  const test::Scene scene = test::random_scene(test::Family::kUsual, 2);
  const LimitedStep limited(scene.chain, scene.tool, test::slow_joints(6), kT);
  const auto path = [&](double) { return scene.at(0); };
  StepRequest request;
  request.path = PathView(path);
  request.horizon = 0.45;
  const Step step = limited.exact(scene.q, JointVector::Zero(6), scene.home, request);
  EXPECT_LT(step.qd.norm(), 1e-9);
  EXPECT_EQ(step.alpha, 1);
  EXPECT_EQ(step.tier, 0);
  EXPECT_STREQ(step.limited_by, "");
  EXPECT_FALSE(step.held);
}

TEST(Limited, TheFlangeKeepsItsSpeed) {
  JointLimits limits = test::slow_joints(6);
  limits.flange_velocity = 0.05;
  const int n = test::family(2, 60);
  double fastest = 0;
  for (int i = 0; i < n; ++i) {
    const test::Scene scene = test::random_scene(test::Family::kUsual, 300 + i);
    if (!test::reach_of(scene, limits).all) continue;
    JointVector last = scene.q;
    test::DriveOptions options;
    options.each = [&](const JointVector& q) {
      const Vector3 moved =
          scene.chain.forward(q).translation() - scene.chain.forward(last).translation();
      fastest = std::max(fastest, moved.norm() / kT);
      last = q;
    };
    const test::Course course = test::drive(scene, limits, JointVector::Zero(6), options);
    EXPECT_TRUE(course.finished);
    EXPECT_EQ(course.violations, 0);
  }
  std::printf("fastest flange %.5f of 0.05 m/s\n", fastest);
  EXPECT_LE(fastest, 0.0505);
}

}  // namespace
}  // namespace surg
