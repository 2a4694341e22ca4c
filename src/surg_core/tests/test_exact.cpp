// The exact form against oracles that know nothing of it.
#include "support/test_arm.hpp"
#include "support/test_support.hpp"
#include "surg_core/law/exact.hpp"

namespace surg {
namespace {

using test::Random;

Vector3 random_unit(Random& random) {
  return Vector3(random.normal(), random.normal(), random.normal()).normalized();
}

Tool random_tool(Random& random) {
  Tool tool;
  tool.s_F = (Vector3::UnitZ() + 0.3 * random_unit(random)).normalized();
  tool.p_FTip = Vector3(random.uniform(-0.08, 0.08), random.uniform(-0.08, 0.08), 0) +
                random.uniform(0.25, 0.4) * tool.s_F;
  return tool;
}

/// An arm somewhere near its home, the trocar on its shaft.
struct Scene {
  Chain chain;
  JointVector q;
  Tool tool;
  Home home;
  Vector3 p_BRcm;
};

Scene random_scene(Random& random) {
  Scene scene;
  const bool panda = random.integer(0, 1) == 1;
  scene.chain = panda ? test::panda_chain() : test::ur5e_chain();
  scene.q = panda ? test::panda_home() : test::ur5e_home();
  for (int i = 0; i < scene.q.size(); ++i) scene.q[i] += random.uniform(-0.2, 0.2);
  scene.tool = random_tool(random);
  const Pose X_BF = scene.chain.forward(scene.q);
  scene.home = home_of(X_BF, scene.tool);
  scene.p_BRcm = X_BF * scene.tool.p_FTip - random.uniform(0.03, 0.2) * scene.home.s_B;
  return scene;
}

/// Every property of a step holds for the generic two stages (false) and for the closed form
/// (true).
class ExactBothWays : public ::testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(ClosedForm, ExactBothWays, ::testing::Bool());

TEST(Exact, ThePoseIsOnTheConstraintWithTipAndRollAsAsked) {
  Random random(1);
  const int n = test::family(2000, 200000);
  for (int i = 0; i < n; ++i) {
    const Scene scene = random_scene(random);
    const Vector3 aside = random_unit(random);
    const Vector3 s = (scene.home.s_B + random.uniform(0, 0.9) * aside).normalized();
    const double depth = random.uniform(0.001, 0.22), roll = random.uniform(-3.1, 3.1);
    const Vector3 p_BTip = scene.p_BRcm + depth * s;
    const Pose X_BF =
        pose_on_pivot(scene.home, scene.tool, tip_goal(scene.p_BRcm, p_BTip, roll, s));
    const ShaftState shaft = shaft_state(X_BF, scene.tool, scene.p_BRcm);
    EXPECT_LT(shaft.e.norm(), 1e-13);
    EXPECT_LT((shaft.p_BTip - p_BTip).norm(), 1e-13);
    EXPECT_NEAR(shaft.depth, depth, 1e-13);
    const double found = absolute_roll(X_BF.linear(), scene.home.R_BF, scene.home.s_B, shaft.s);
    EXPECT_NEAR(std::remainder(found - roll, 2 * M_PI), 0, 1e-9);
    // And the same from the four angles.
    const Pose X_BR = rcm_frame(scene.home.s_B, scene.p_BRcm);
    const Eigen::Vector2d angles = shaft_angles(X_BR.linear().transpose() * s);
    const ShaftGoal goal = spherical_goal(X_BR, {angles[0], angles[1], depth, roll});
    EXPECT_LT((pose_on_pivot(scene.home, scene.tool, goal).matrix() - X_BF.matrix())
                  .cwiseAbs()
                  .maxCoeff(),
              1e-12);
  }
  test::report("random tools and goals", n);
}

TEST_P(ExactBothWays, HomeIsItsOwnGoal) {
  Random random(2);
  const int n = test::family(500, 50000);
  for (int i = 0; i < n; ++i) {
    const Scene scene = random_scene(random);
    const Pose X_BF = scene.chain.forward(scene.q);
    const ShaftState shaft = shaft_state(X_BF, scene.tool, scene.p_BRcm);
    const Pose X_goal = pose_on_pivot(scene.home, scene.tool,
                                      tip_goal(scene.p_BRcm, shaft.p_BTip, 0, scene.home.s_B));
    const JointStep step =
        NextPose(scene.chain, GetParam()).step(scene.q, X_goal, JointVector::Zero(scene.q.size()));
    EXPECT_LT(step.dq.norm(), 1e-11);
  }
  test::report("arms at home", n);
}

TEST_P(ExactBothWays, AStepOfAControlCycleMeetsThePose) {
  Random random(3);
  const int n = test::family(2000, 200000);
  double worst = 0, worst_step = 0;
  int met = 0;
  for (int i = 0; i < n; ++i) {
    const Scene scene = random_scene(random);
    const ShaftState shaft = shaft_state(scene.chain.forward(scene.q), scene.tool, scene.p_BRcm);
    // 2 ms at up to 0.25 m/s and 2 rad/s; the trocar moves as well.
    const Vector3 p_BRcm = scene.p_BRcm + random.uniform(0, 2e-5) * random_unit(random);
    const Vector3 p_BTip = shaft.p_BTip + random.uniform(0, 5e-4) * random_unit(random);
    const ShaftGoal goal = tip_goal(p_BRcm, p_BTip, random.uniform(-0.004, 0.004), shaft.s);
    if (goal.depth < 0.02) continue;
    const Pose X_goal = pose_on_pivot(scene.home, scene.tool, goal);
    const JointStep step =
        NextPose(scene.chain, GetParam()).step(scene.q, X_goal, JointVector::Zero(scene.q.size()));
    ASSERT_GT(step.conditioning, 0);
    if (step.dq.cwiseAbs().maxCoeff() > 0.0063) continue;  // 180 degrees/s, the arms' limit
    ++met;
    const ShaftState after =
        shaft_state(scene.chain.forward(scene.q + step.dq), scene.tool, p_BRcm);
    worst = std::max({worst, after.e.norm(), (after.p_BTip - p_BTip).norm()});
    worst_step = std::max(worst_step, step.dq.cwiseAbs().maxCoeff());
  }
  std::printf("pose met to %.1e m after joint steps of up to %.3f rad\n", worst, worst_step);
  EXPECT_LT(worst, 1e-9);
  test::report("random steps", met);
  EXPECT_GT(met, n / 2);
}

TEST(Exact, ANewtonStepTurnsByTheRotationVector) {
  // With the identity for a Jacobian the step is the twist itself.
  Random random(7);
  Jacobian J(6, 6);
  J.setIdentity();
  for (const double angle : {0.01, 0.1, 0.3}) {
    const Vector3 axis = random_unit(random);
    Pose X_goal = Pose::Identity();
    X_goal.linear() = Eigen::AngleAxisd(angle, axis).toRotationMatrix();
    X_goal.translation() = Vector3(0.1, 0.2, 0.3);
    const JointStep step = newton_step(Pose::Identity(), J, X_goal, JointVector::Zero(6));
    EXPECT_LT((step.dq.tail<3>() - angle * axis).norm(), 0.1 * std::pow(angle, 5) + 1e-14);
    EXPECT_LT((step.dq.head<3>() - X_goal.translation()).norm(), 1e-15);
  }
}

TEST(Exact, SpareJointsFollowThePostureWithoutMovingThePose) {
  Random random(4);
  const int n = test::family(500, 50000);
  for (int i = 0; i < n; ++i) {
    Scene scene = random_scene(random);
    if (scene.q.size() == 6) continue;
    const Pose X_BF = scene.chain.forward(scene.q);
    JointVector pull(7);
    for (int k = 0; k < 7; ++k) pull[k] = random.uniform(-1e-3, 1e-3);
    const JointStep step = exact_step(scene.chain, scene.q, X_BF, pull);
    const Pose after = scene.chain.forward(scene.q + step.dq);
    EXPECT_LT((after.matrix() - X_BF.matrix()).cwiseAbs().maxCoeff(), 1e-9);
    EXPECT_GT(step.dq.dot(pull), 0);  // a projection: never against what was wished
    EXPECT_LE(step.dq.norm(), pull.norm() * (1 + 1e-3));
  }
  test::report("random postures", n);
}

TEST_P(ExactBothWays, ASingularArmIsReportedAndStays) {
  const Chain chain = test::ur5e_chain();
  JointVector q = test::ur5e_home();
  q[4] = 0;  // wrist axes 4 and 6 parallel
  Pose X_goal = chain.forward(q);
  const NextPose next(chain, GetParam());
  const JointStep step = next.step(q, X_goal, JointVector::Zero(6));
  EXPECT_EQ(step.conditioning, 0);
  EXPECT_EQ(step.dq, JointVector::Zero(6));
  X_goal.translation().x() = std::nan("");
  EXPECT_EQ(next.step(test::ur5e_home(), X_goal, JointVector::Zero(6)).conditioning, 0);
}

TEST(Exact, RcmRowsAreTheDerivativeOfTheLateralError) {
  Random random(5);
  const int n = test::family(500, 50000);
  const double h = 1e-6;
  double worst = 0;
  for (int i = 0; i < n; ++i) {
    Scene scene = random_scene(random);
    scene.p_BRcm += 0.002 * random_unit(random);
    Pose X_BF;
    Jacobian J;
    scene.chain.forward(scene.q, X_BF, J);
    const ShaftState shaft = shaft_state(X_BF, scene.tool, scene.p_BRcm);
    const RcmRows rows = rcm_rows(J, shaft);
    EXPECT_NEAR(rows.e.norm(), shaft.e.norm(), 1e-13);
    JointVector qd(scene.q.size());
    for (int k = 0; k < qd.size(); ++k) qd[k] = random.uniform(-1, 1);
    const auto error = [&](double t) {
      return shaft_state(scene.chain.forward(scene.q + t * qd), scene.tool, scene.p_BRcm).e;
    };
    const Vector3 e_dot = (error(h) - error(-h)) / (2 * h);
    const Eigen::Vector2d lateral = rows.J * qd;
    // |e|'s rate: only what happens across the shaft counts.
    worst = std::max(worst, std::abs(e_dot.dot(shaft.e) + lateral.dot(rows.e)) / shaft.e.norm());
  }
  EXPECT_LT(worst, 1e-8);
  test::report("random rows", n);
}

TEST(Exact, TheCorrectionPutsTheShaftBackEvenAtASingularArm) {
  Random random(6);
  const int n = test::family(500, 50000);
  double worst = 0;
  for (int i = 0; i < n; ++i) {
    Scene scene = random_scene(random);
    if (scene.q.size() == 6) scene.q[4] = 0;  // singular wrist
    const Vector3 s = scene.chain.forward(scene.q).linear() * scene.tool.s_F;
    scene.p_BRcm = scene.chain.forward(scene.q) * scene.tool.p_FTip - 0.12 * s +
                   1e-5 * s.cross(random_unit(random));
    Pose X_BF;
    Jacobian J;
    scene.chain.forward(scene.q, X_BF, J);
    const JointStep step = rcm_correction(rcm_rows(J, shaft_state(X_BF, scene.tool, scene.p_BRcm)));
    ASSERT_GT(step.conditioning, 0);
    const double left =
        shaft_state(scene.chain.forward(scene.q + step.dq), scene.tool, scene.p_BRcm).e.norm();
    worst = std::max(worst, left);
  }
  EXPECT_LT(worst, 1e-8);  // quadratic: 10 um to below 0.01 um
  test::report("corrections", n);
}

TEST(Exact, RowsWithoutAWayAreReported) {
  RcmRows rows;
  rows.J.setZero(2, 6);
  rows.e = {1e-3, 0};
  EXPECT_EQ(rcm_correction(rows).conditioning, 0);
  EXPECT_EQ(rcm_correction(rows).dq, JointVector::Zero(6));
}

TEST(Exact, LeavesTheHeapAlone) {
  if (!SURG_HEAP_IS_WATCHED) GTEST_SKIP();
  for (const bool panda : {false, true}) {
    const Chain chain = panda ? test::panda_chain() : test::ur5e_chain();
    const JointVector q = panda ? test::panda_home() : test::ur5e_home();
    const JointVector none = JointVector::Zero(q.size());
    const Tool tool{Vector3::UnitZ(), Vector3(0.06, 0, 0.3)};
    Pose X_BF;
    Jacobian J;
    chain.forward(q, X_BF, J);
    const Home home = home_of(X_BF, tool);
    const Vector3 p_BRcm = X_BF * tool.p_FTip - 0.12 * home.s_B;
    const Vector3 p_BTip = X_BF * tool.p_FTip + Vector3(1e-4, 0, 0);
    test::HeapWatch heap;
    const Pose goal = pose_on_pivot(home, tool, tip_goal(p_BRcm, p_BTip, 0.001, home.s_B));
    const JointStep step = exact_step(chain, q, goal, none);
    const RcmRows rows = rcm_rows(J, shaft_state(X_BF, tool, p_BRcm));
    const JointStep back = rcm_correction(rows);
    const long calls = heap.calls();
    EXPECT_GT(step.conditioning, 0);
    EXPECT_GT(back.conditioning, 0);
    EXPECT_EQ(calls, 0);
  }
}

}  // namespace
}  // namespace surg
