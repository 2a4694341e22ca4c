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
    const ShaftGoal goal = test::spherical_goal(X_BR, {angles[0], angles[1], depth, roll});
    EXPECT_LT((pose_on_pivot(scene.home, scene.tool, goal).matrix() - X_BF.matrix())
                  .cwiseAbs()
                  .maxCoeff(),
              1e-12);
  }
  test::report("random tools and goals", n);
}

TEST(Exact, RcmRowsAreTheDerivativeOfTheLateralError) {
  Random random(5);
  const int n = test::family(500, 50000);
  const double h = 1e-6;
  double worst = 0;
  for (int i = 0; i < n; ++i) {
    Scene scene = random_scene(random);
    scene.p_BRcm += 0.002 * random_unit(random);
    const auto [X_BF, J] = scene.chain.flange(scene.q);
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
    const auto [X_BF, J] = scene.chain.flange(scene.q);
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

}  // namespace
}  // namespace surg
