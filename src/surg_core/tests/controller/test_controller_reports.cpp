// What the controller reports is true: rates are those of the positions, warnings and reasons come
// where their limits are. The oracle is the plant's joints and finite differences.
#include <vector>

#include "support/controller_bench.hpp"
#include "support/test_support.hpp"

namespace surg {
namespace {

using namespace test;

/// On a path with swing and roll at once: the shaft's swing turns the instrument too (holonomy),
/// with the wrong sign the roll's rate would be off by up to 0.1 rad/s.
TEST(ControllerReports, EveryVirtualRateIsTheDifferenceOfItsPosition) {
  Bench bench;
  Vector4 before = Vector4::Zero(), worst = Vector4::Zero();
  double swing = 0;
  for (int i = 0; i < 3000; ++i) {
    const double t = i * kT, ramp = std::min(1.0, t);
    bench.servo_cp(Vector3(0.07 * ramp * std::sin(1.5 * t), 0.07 * ramp * (1 - std::cos(1.5 * t)),
                           0.12 + 0.02 * ramp * std::sin(2 * t)),
                   0.8 * ramp * std::sin(1.1 * t));
    const Outputs& out = bench.tick();
    if (i > 1) {
      const Vector4 difference = (out.virtual_q - before) / kT;
      // The measured rate was constant between the two samples of this plant.
      const Vector4 off = (out.virtual_qd - difference).cwiseAbs();
      worst = worst.cwiseMax(off);
      swing = std::max(
          swing,
          Vector3(bench.controller().X_BR().linear().transpose() * out.s_B).head<2>().norm());
    }
    before = out.virtual_q;
  }
  EXPECT_GT(swing, 0.5) << "too straight to tell";
  EXPECT_LT(worst.maxCoeff(), 0.01) << worst.transpose();
}

TEST(ControllerReports, TheShaftBesideItsTrocarIsWarnedOfBeforeItFaults) {
  for (const auto& [beside, warned] : {std::pair{0.0008, false}, {0.0012, true}, {0.0018, true}}) {
    Bench bench;
    JointVector q = bench.in().q;
    const Vector3 p_BRcm = bench.out().p_BRcm;
    const auto off = [&](const JointVector& joints) {
      const Pose X = bench.chain().forward(joints);
      const Vector3 s = X.linear().col(2), to = p_BRcm - X * test::offset_tool().p_FTip;
      return (to - s * s.dot(to)).norm();
    };
    while (off(q) < beside) q[0] += 1e-5;  // the arm is pushed
    bench.in().q = q;
    bench.tick();
    EXPECT_EQ(bench.out().state, State::kEnabled);
    EXPECT_NEAR(bench.out().rcm_error, beside, 2e-5);
    EXPECT_EQ(bench.out().warn_rcm, warned) << 1e3 * beside << " mm";
  }
}

/// The set-point runs 10 mm ahead of a blocked arm, not farther, also where the velocities that the
/// arm reports are wrong. Where they are right, they tell sooner.
TEST(ControllerReports, ABlockedArmIsPausedWhenItsSetPointIsTenMillimetresAhead) {
  for (const bool velocities_are_right : {false, true}) {
    Bench bench;
    const JointVector stuck = bench.in().q;
    const double speed = velocities_are_right ? 0.02 : 0.05;  // slower, and its standstill tells
    double ahead = 0;
    for (int i = 0; i < 2000 && bench.out().state == State::kEnabled; ++i) {
      bench.servo_cp(Vector3(speed * i * kT, 0, 0.12));
      bench.tick();
      ahead = std::max(ahead, (bench.out().p_set - bench.out().p_BTip).norm());
      bench.in().q = stuck;
      bench.in().qd = velocities_are_right ? JointVector(0 * stuck) : bench.out().qd_command;
    }
    EXPECT_EQ(bench.out().reason, Reason::kNotFollowing);
    if (velocities_are_right) {
      EXPECT_LT(ahead, 0.004);
    } else {
      EXPECT_NEAR(ahead, 0.010, 2e-4);
    }
  }
}

}  // namespace
}  // namespace surg
