// Limits of the controller near the trocar, under force, at a jump in roll and above top speed; the
// cause of a fault; authority while the arm moves.
#include "support/controller_bench.hpp"
#include "support/test_support.hpp"
#include "surg_core/limits/workspace.hpp"
#include "surg_core/state/gate.hpp"

namespace surg {
namespace {

using test::Bench;

TEST(ControllerLimits, F24LateralMotionFadesTowardsTheTrocar) {
  constexpr double kAside = 0.02;  // [m/s]
  for (const double depth : {0.0212, 0.0225, 0.024, 0.026, 0.028, 0.04}) {
    Bench bench;
    const Limits& limits = bench.robot().limits;
    MotionCommand command = test::command(Motion::kMoveCp, Vector3(0, 0, depth));
    bench.send(command);
    for (int i = 0; i < 2000; ++i) bench.tick();
    ASSERT_NEAR(bench.out().depth, depth, 1e-4);
    command.motion = Motion::kServoCv;
    command.p = Vector3(kAside, 0, 0);
    double fastest = 0;
    for (int i = 0; i < 60; ++i) {
      bench.send(command);
      const Outputs& out = bench.tick();
      const Vector3 v = bench.controller().X_BR().linear().transpose() * out.v_BTip;
      const double fade = std::clamp(
          (out.depth - limits.depth_min) / (limits.depth_slow - limits.depth_min), 0., 1.);
      // The feedback fades as well, whatever the set-point is ahead.
      const double wish = kAside + bench.robot().tuning.tip_gain * (out.p_set - out.p_BTip).norm();
      ASSERT_LE(v.head<2>().norm(), (fade + 0.03) * wish) << "at " << out.depth << " m";
      fastest = std::max(fastest, v.x());
    }
    ASSERT_EQ(bench.out().state, State::kEnabled);
    EXPECT_TRUE(depth < limits.depth_slow || fastest > 0.9 * kAside) << fastest;
  }
}

TEST(ControllerLimits, F25TheTipsFollowUpYieldsInTheVelocityFormToo) {
  Controller::Options options;
  options.law = Law::kVelocity;
  Bench aside(options);  // a tip that is 1 mm off the set-point, on the pivot
  aside.send(test::command(Motion::kMoveCp, Vector3(-0.001, 0, 0.12)));
  for (int i = 0; i < 1000; ++i) aside.tick();
  for (const double side : {-1.0, 1.0}) {  // the force stands against the way back, or helps
    Bench bench(options);
    bench.in().q = aside.in().q;
    const Vector3 x = bench.controller().X_BR().linear().col(0);
    bench.in().tip_force = {true, Vector3(6 * side * x)};
    double most = 0;  // [m/s] of the way back
    for (int i = 0; i < 45; ++i) {
      const Outputs& out = bench.tick();
      const Vector3 omega = out.twist_command.tail<3>(), v = out.twist_command.head<3>();
      const Vector3 lever = out.p_BTip - out.X_BF.translation();
      most = std::max(most, x.dot(Vector3(v + omega.cross(lever))));
      ASSERT_EQ(out.state, State::kEnabled);
    }
    if (side < 0) {
      EXPECT_LT(most, 1e-4);
    } else {
      EXPECT_GT(most, 1e-3);
    }
  }
}

TEST(ControllerLimits, F25TheWayBackToThePathYieldsInTheExactFormToo) {
  RobotConfig weak = Bench::robot_with_lag(0);
  weak.acceleration.setConstant(3);
  for (const double side : {-1.0, 1.0}) {  // the force stands against the way back, or helps
    Bench bench({}, 0, 0, 0, &weak);
    for (int i = 0; i < 650; ++i) {  // too fast for the joints: the tip leaves its path
      const double t = i * test::kT;
      bench.servo_cp(Vector3(0.02 * std::sin(10 * t), 0.02 * std::sin(7 * t), 0.12));
      bench.tick();
    }
    for (int i = 0; i < 200; ++i) bench.tick();  // the stream ends, the set-point comes to rest
    const auto tip_in_R = [&] { return bench.tip_in_R(); };
    const Vector3 off = bench.controller().X_BR().inverse() * bench.out().p_set - tip_in_R();
    ASSERT_GT(off.norm(), 3e-4);
    const Vector3 back = off.normalized();
    bench.in().tip_force = {true, Vector3(6 * side * (bench.controller().X_BR().linear() * back))};
    Vector3 last = tip_in_R();
    double most = -1, fastest_set = 0;  // [m/s] of the way back once braked, of the set-point
    for (int k = 0; k < 45; ++k) {
      const Outputs& out = bench.tick();
      if (k > 10) most = std::max(most, (tip_in_R() - last).dot(back) / test::kT);
      last = tip_in_R();
      fastest_set = std::max(fastest_set, out.v_set.norm());
      ASSERT_EQ(out.state, State::kEnabled);
    }
    EXPECT_LT(fastest_set, 1e-6);
    if (side < 0) {
      EXPECT_LT(most, 1e-4);
    } else {
      EXPECT_GT(most, 1e-3);
    }
  }
}

TEST(ControllerLimits, F25AnArmThatOvershotAwayFromAForceIsNotPulledBackAgainstIt) {
  for (const double side : {-1.0, 1.0}) {  // the force stands against the way back, or helps
    Bench bench({}, 2, 0.008);             // a lag of 12 ms that nobody has stated
    MotionCommand command = test::command(Motion::kServoCv);
    const auto drive = [&](double v, int cycles) {
      command.p = Vector3(v, 0, 0);
      for (int i = 0; i < cycles; ++i) bench.ask(command);
    };
    drive(0.1, 150);
    drive(0, 40);  // the arm is beyond its set-point
    const Vector3 x = bench.controller().X_BR().linear().col(0);
    bench.in().tip_force = {true, Vector3(6 * -side * x)};
    double farthest = -1, back = 0;  // [m]
    for (int k = 0; k < 45; ++k) {
      drive(0, 1);
      farthest = std::max(farthest, bench.tip_in_R().x());
      back = farthest - bench.tip_in_R().x();
      ASSERT_EQ(bench.out().state, State::kEnabled);
    }
    std::printf("force %s the way back: back by %.3f mm\n", side < 0 ? "against" : "along",
                1e3 * back);
    if (side < 0) {
      EXPECT_LT(back, 2e-5);
    } else {
      EXPECT_GT(back, 2e-4);
    }
  }
}

TEST(ControllerLimits, AWeakArmStartsBackToItsSetPointFromRest) {
  for (const Law law : {Law::kVelocity, Law::kExact}) {
    Controller::Options options;
    options.law = law;
    Bench aside(options);
    aside.send(test::command(Motion::kMoveCp, Vector3(-0.004, 0, 0.12)));
    for (int i = 0; i < 1000; ++i) aside.tick();
    Bench bench(options);  // its set-point is at home, and there it stays
    bench.in().qd = (aside.in().q - bench.in().q) / test::kT;  // pushed there in one cycle
    bench.in().q = aside.in().q;
    Outputs out = bench.tick();
    const double off = (out.p_BTip - out.p_set).norm();
    EXPECT_GT(off, 1e-3);
    for (int i = 0; i < 1000; ++i) out = bench.tick();
    EXPECT_LT((out.p_BTip - out.p_set).norm(), 0.02 * off) << "law " << static_cast<int>(law);
  }
}

/// Joints of 15 rad/s^2 brake a tip later than its own limits ask for.
TEST(ControllerLimits, AVelocityStopsBeforeTheWallAsTheJointsCan) {
  test::Random random(46);
  const int runs = test::family(60, 1000);
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    double worst = -1;
    int walls = 0;
    for (int run = 0; run < runs; ++run) {
      RobotConfig robot = Bench::robot_with_lag(0);
      robot.velocity.setConstant(6);
      for (int i = 0; i < 6; ++i) robot.home[i] += random.uniform(-0.2, 0.2);
      Bench bench({law}, 0, 0, 0, &robot);
      MotionCommand command = test::command(Motion::kServoJv);
      command.joints = Vector4(random.uniform(-1.5, 1.5), random.uniform(-1.5, 1.5),
                               random.uniform(0, 0.2), random.uniform(-1, 1));
      double outside = -1;
      for (int k = 0; k < 1000; ++k) {
        bench.ask(command);
        outside = std::max(outside, outside_workspace(bench.robot().limits, bench.tip_in_R()));
      }
      walls += outside > -5e-3;
      worst = std::max(worst, outside);
    }
    std::printf("law %d: %.2f mm outside at most, %d of %d runs at a wall\n", static_cast<int>(law),
                1e3 * worst, walls, runs);
    EXPECT_LT(worst, test::family(2, 3) * 1e-3);
    EXPECT_GT(walls, runs / 3);
  }
}

TEST(ControllerLimits, AStreamMayNotJumpInRoll) {
  Bench bench;
  const Vector3 p(0, 0, 0.12);
  bench.servo_cp(p, 0.2);
  EXPECT_EQ(bench.tick().verdicts[0].reason, Reason::kStreamStartTooFar);
  for (int i = 0; i < 60; ++i) bench.tick();  // it must end before another may begin
  for (int i = 0; i < 10; ++i) {
    bench.servo_cp(p, 0.0);
    EXPECT_EQ(bench.tick().verdicts[0].reason, Reason::kNone);
  }
  bench.servo_cp(p, 0.2);
  EXPECT_EQ(bench.tick().verdicts[0].reason, Reason::kStepTooLarge);
  bench.servo_cp(p, 0.03);
  EXPECT_EQ(bench.tick().verdicts[0].reason, Reason::kNone);
}

TEST(ControllerLimits, TooFastAWishKeepsItsDirection) {
  Bench bench;
  for (int i = 0; i < 120; ++i) bench.ask(test::command(Motion::kServoCv, Vector3(1.0, 0, 0.5)));
  const Vector3 v = bench.controller().X_BR().linear().transpose() * bench.out().v_set;
  EXPECT_GT(v.x(), 0.05);
  EXPECT_NEAR(v.z(), 0.5 * v.x(), 0.05 * v.x());
}

/// x, y, z, roll and yaw, pitch, insertion, roll: each accelerates no harder than its own jerk.
/// From the plant's measured motion, by differences; joints strong enough not to limit it.
TEST(ControllerLimits, EveryDegreeOfFreedomKeepsItsOwnJerk) {
  Document document = test::good_robot();
  document.values["limits.tip_jerk"] = 20.0;
  document.values["limits.pivot_jerk"] = 60.0;
  document.values["limits.roll_jerk"] = 90.0;
  document.values["joints.acceleration"] = std::vector<double>(6, 50.0);
  const RobotConfig robot = test::robot_behind(document);
  for (const bool spherical : {false, true}) {
    for (int dof = 0; dof < 4; ++dof) {
      const bool length = dof < 3 && (!spherical || dof == 2);
      const double most = dof == 3 ? 90 : length ? 20 : 60;
      Bench bench({}, 0, 0, 0, &robot);
      MotionCommand command = test::command(spherical ? Motion::kServoJv : Motion::kServoCv);
      (dof == 3 && !spherical ? command.roll_rate
       : spherical            ? command.joints[dof]
                              : command.p[dof]) = length ? 0.04 : 0.3;
      std::vector<double> x;
      for (int i = 0; i < 200; ++i) {
        bench.send(command);
        const Outputs& out = bench.tick();
        ASSERT_EQ(out.scale, 1) << out.limited_by;
        x.push_back(dof == 3 ? out.roll : spherical ? out.virtual_q[dof] : bench.tip_in_R()[dof]);
      }
      double jerk = 0;
      for (std::size_t i = 3; i < x.size(); ++i) {
        const double third = x[i] - 3 * x[i - 1] + 3 * x[i - 2] - x[i - 3];
        jerk = std::max(jerk, std::abs(third) / std::pow(test::kT, 3));
      }
      EXPECT_LT(jerk, 1.02 * most) << "spherical " << spherical << ", " << dof;
      EXPECT_GT(jerk, 0.8 * most) << "too gentle to tell";
    }
  }
}

/// Between two samples the joints go straight, and the pivot's curve does not: at full speed its
/// sagitta would be 0.8 um.
TEST(ControllerLimits, BetweenSamplesThePivotStaysWithinHalfAMicrometre) {
  test::Random random(3);
  RobotConfig robot = test::robot_behind(test::good_robot());
  robot.acceleration.setConstant(40);
  double worst = 0;
  for (int run = 0; run < test::family(10, 200); ++run) {
    Bench bench({}, 0, 0, 0, &robot);
    MotionCommand command = test::command(Motion::kServoCv);
    for (int i = 0; i < 2000; ++i) {
      if (i % 100 == 0) {
        for (int k = 0; k < 3; ++k) command.p[k] = random.uniform(-0.25, 0.25);
        command.roll_rate = random.uniform(-1, 1) > 0 ? 3 : -3;
      }
      bench.send(command);
      const JointVector q = bench.in().q;
      const Outputs& out = bench.tick();
      if (out.tier > 0) continue;
      const Pose X_BF = bench.chain().forward(JointVector(q + 0.5 * test::kT * out.qd_command));
      const Vector3 s = X_BF.linear() * test::offset_tool().s_F;
      const Vector3 to = out.p_BRcm - X_BF * test::offset_tool().p_FTip;
      worst = std::max(worst, (to - s * s.dot(to)).norm());
    }
  }
  EXPECT_LT(worst, 0.5e-6);
  EXPECT_GT(worst, 0.35e-6) << "too slow to tell";
}

TEST(ControllerLimits, TheFirstCauseOfAFaultStays) {
  Bench bench;
  bench.controller().fault(Reason::kOverrun);
  bench.controller().fault(Reason::kMasterLost);
  EXPECT_EQ(bench.tick().reason, Reason::kOverrun);
}

TEST(ControllerLimits, F26TheArmIsNotFreeWhileItMoves) {
  Bench bench;
  MotionCommand mine, other;
  mine.motion = other.motion = Motion::kMoveCp;
  mine.source = test::kMe;
  other.source = test::kOther;
  mine.p = other.p = Vector3(0.09, 0, 0.13);
  bench.ask(mine);
  int refused = 0;
  // Over half a second, and no command of mine.
  for (; (bench.out().p_set - bench.out().p_goal).norm() > 1e-3; ++refused) {
    ASSERT_EQ(bench.ask(other), Reason::kNoAuthority);
    ASSERT_EQ(bench.out().source, test::kMe);
  }
  EXPECT_GT(refused, 260);
}

TEST(ControllerLimits, AStreamThatPausedMayNotMakeUpForMoreThanStepDtMax) {
  const Limits limits = Bench().robot().limits;
  const double reach = limits.tip_velocity * limits.step_dt_max + limits.step_slack;
  const double turn = limits.roll_velocity * limits.step_dt_max + limits.step_roll_slack;
  for (const double since : {limits.step_dt_max, 0.4, 10.0}) {
    EXPECT_EQ(check_step(limits, false, since, 0.999 * reach, 0), Reason::kNone);
    EXPECT_EQ(check_step(limits, false, since, 1.001 * reach, 0), Reason::kStepTooLarge);
    EXPECT_EQ(check_step(limits, false, since, 0, 0.999 * turn), Reason::kNone);
    EXPECT_EQ(check_step(limits, false, since, 0, 1.001 * turn), Reason::kStepTooLarge);
  }
}

TEST(ControllerLimits, F03AStreamStartsAtTheSetPointHoweverLongTheSilenceWas) {
  const Limits limits = Bench().robot().limits;
  for (const double since : {0.0, limits.step_dt_max, 10.0}) {
    EXPECT_EQ(check_step(limits, true, since, 0.999 * limits.step_slack, 0), Reason::kNone);
    EXPECT_EQ(check_step(limits, true, since, 1.001 * limits.step_slack, 0),
              Reason::kStreamStartTooFar);
    EXPECT_EQ(check_step(limits, true, since, 0, 1.001 * limits.step_roll_slack),
              Reason::kStreamStartTooFar);
  }
}

}  // namespace
}  // namespace surg
