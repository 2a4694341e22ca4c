// Moves end at their target or say that they do not; roll goes on across half turns; a start takes
// over the motion that there is. The oracle is the plant's joints.
#include "support/controller_bench.hpp"
#include "support/test_support.hpp"

namespace surg {
namespace {

using namespace test;

void finish(Bench& bench) {
  for (int i = 0; i < 30000 && bench.out().busy; ++i) bench.tick();
  EXPECT_FALSE(bench.out().busy);
}

Reason send_move(Bench& bench, const Vector3& p, double roll = 0) {
  bench.send(bench.pose(Motion::kMoveCp, p, roll));
  return bench.tick().verdicts[0].reason;
}

/// F24. Between depth_min and depth_slow targets lead along the shaft only. The check of the
/// profile asks no more than the present depth, so this is the gate's alone.
TEST(ControllerMoves, ASidewaysMoveInTheShallowZoneIsRefused) {
  Bench bench;
  ASSERT_EQ(send_move(bench, Vector3(0, 0, 0.025)), Reason::kNone);
  finish(bench);
  ASSERT_NEAR(bench.out().depth, 0.025, 1e-4);
  const double tilt = 0.005 / 0.027;
  EXPECT_EQ(send_move(bench, 0.027 * Vector3(std::sin(tilt), 0, std::cos(tilt))),
            Reason::kOutsideWorkspace);
  EXPECT_EQ(send_move(bench, Vector3(0, 0, 0.022)), Reason::kNone);
}

/// F24. Its ends are deep enough, but the straight line between them passes the shallow zone at
/// 26.8 mm, where a profile would not fade.
TEST(ControllerMoves, AMoveWhoseWayPassesTheShallowZoneIsRefused) {
  Bench bench;
  MotionCommand aside = command(Motion::kMoveJp);
  aside.joints = Vector4(0.7, 0, 0.035, 0);
  bench.ask(aside);
  finish(bench);
  ASSERT_NEAR(bench.out().virtual_q[0], 0.7, 5e-3);
  EXPECT_EQ(send_move(bench, 0.035 * shaft_direction(-0.7, 0)), Reason::kOutsideWorkspace);
  EXPECT_EQ(send_move(bench, 0.05 * shaft_direction(-0.7, 0)), Reason::kNone);
}

/// From full speed towards the wall the profile would overshoot it: the tip stops first, and then
/// it goes where it was told.
TEST(ControllerMoves, AMoveThatMustStopFirstReachesItsTarget) {
  RobotConfig robot = robot_behind(good_robot());
  robot.acceleration.setConstant(40);
  Bench bench({}, 0, 0, 0, &robot);
  MotionCommand down = command(Motion::kServoCv, Vector3(0, 0, 0.2));
  while (bench.out().depth < 0.206) {
    bench.ask(down);
  }
  const double speed = bench.out().v_set.norm();
  EXPECT_GT(speed, 0.1);
  const Vector3 to(0.02, 0, 0.208);
  ASSERT_EQ(send_move(bench, to), Reason::kNone);
  bool stopped = false;
  double deepest = 0;
  while (bench.out().busy) {
    bench.tick();
    deepest = std::max(deepest, bench.out().depth);
    stopped |= bench.out().v_set.norm() < 1e-3 && (bench.tip_in_R() - to).norm() > 2e-3;
  }
  EXPECT_TRUE(stopped) << "a profile from this motion would have stayed inside";
  EXPECT_LT(deepest, 0.2205);
  EXPECT_LT((bench.tip_in_R() - to).norm(), 6e-4);
}

/// A force stops the set-point on its way: at rest, but not where it was sent.
TEST(ControllerMoves, AMoveThatAForceStoppedIsNotArrived) {
  Bench bench;
  ASSERT_EQ(send_move(bench, Vector3(0.09, 0, 0.13)), Reason::kNone);
  for (int i = 0; i < 120; ++i) bench.tick();
  Reason said = Reason::kNone;
  for (int i = 0; i < 2000 && bench.out().busy; ++i) {
    const Vector3 against = -bench.controller().X_BR().linear().col(0);
    bench.in().tip_force = {true, Vector3((i < 30 ? 6.0 : 0.0) * against)};  // 60 ms: no PAUSED
    bench.tick();
    if (bench.out().reason != Reason::kNone) said = bench.out().reason;
  }
  EXPECT_EQ(bench.out().state, State::kEnabled);
  EXPECT_FALSE(bench.out().busy);
  EXPECT_GT((bench.tip_in_R() - Vector3(0.09, 0, 0.13)).norm(), 0.005);
  EXPECT_EQ(said, Reason::kNotArrived);
}

/// A joint that is stuck at the end of a roll leaves the tip where it shall be. Its velocity, which
/// would tell, is wrong, and it has turned too far to have stood still.
TEST(ControllerMoves, AMoveWhoseRollIsMissingIsNotArrived) {
  Bench bench;
  bench.send(bench.pose(Motion::kMoveCp, bench.tip_in_R(), 1.0));
  Reason said = Reason::kNone;
  do {
    const JointVector before = bench.in().q;
    bench.tick();
    if (bench.out().reason != Reason::kNone) said = bench.out().reason;
    if (bench.out().roll > 0.985) bench.in().q = before;
  } while (bench.out().busy && bench.ticks < 3000);
  EXPECT_FALSE(bench.out().busy);
  EXPECT_EQ(said, Reason::kNotArrived);
}

/// Orientations repeat after a turn; roll does not.
TEST(ControllerMoves, AStreamAndAMoveGoOnAcrossHalfATurn) {
  Bench bench;
  double roll = 0;
  for (; roll < 4.6; roll += 0.001) {
    bench.servo_cp(Vector3(0, 0, 0.12), roll);
    ASSERT_EQ(bench.tick().verdicts[0].reason, Reason::kNone) << roll;
  }
  for (int i = 0; i < 200; ++i) bench.tick();
  EXPECT_NEAR(bench.out().roll, roll, 0.02);
  ASSERT_EQ(send_move(bench, Vector3(0, 0, 0.12), 5.0), Reason::kNone);
  finish(bench);
  EXPECT_NEAR(bench.out().roll, 5.0, 0.011);
}

/// The way back from beyond half a turn passes it the same way, and a later command finds the roll
/// where it is.
TEST(ControllerMoves, AWayBackFromBeyondHalfATurnKeepsItsTurns) {
  Bench bench;
  for (int i = 0; i < 10; ++i) bench.tick();
  const JointVector home = bench.in().q;
  MotionCommand turn = command(Motion::kMoveJp);
  turn.joints = Vector4(0, 0, 0.12, 4.2);
  bench.ask(turn);
  finish(bench);
  bench.send(command(Motion::kRetrace));
  double last = bench.out().roll_set, jump = 0;
  do {
    bench.tick();
    jump = std::max(jump, std::abs(bench.out().roll_set - last));
    last = bench.out().roll_set;
    ASSERT_NEAR(bench.out().roll_set, bench.out().roll, 0.02);
    if (std::abs(bench.out().roll - 3.9) < 2e-3) {  // held here: the set-point stays at this turn
      bench.send(command(Motion::kHold));
      break;
    }
  } while (bench.out().busy);
  for (int i = 0; i < 300; ++i) bench.tick();
  EXPECT_LT(jump, 0.01);
  EXPECT_NEAR(bench.out().roll, 3.9, 0.1);
  EXPECT_NEAR(bench.out().roll_set, bench.out().roll, 0.01);
  bench.ask(command(Motion::kRetrace));
  finish(bench);
  EXPECT_LT((bench.in().q - home).cwiseAbs().maxCoeff(), 2e-3);
}

/// What was recorded before the arm was led by hand is no way back from where it is now.
TEST(ControllerMoves, AnArmThatWasMovedByHandStartsANewTrace) {
  Bench led;
  ASSERT_EQ(send_move(led, Vector3(-0.03, 0.02, 0.1)), Reason::kNone);
  finish(led);
  Bench bench;
  ASSERT_EQ(send_move(bench, Vector3(0.03, 0.02, 0.14)), Reason::kNone);
  finish(bench);
  bench.controller().request(StateCommand::kDisable);
  for (int i = 0; i < 200; ++i) bench.tick();
  bench.in().q = led.in().q;  // the same trocar and home
  bench.tick();
  ASSERT_EQ(bench.controller().request(StateCommand::kEnable), Reason::kNone);
  bench.tick();
  const JointVector here = bench.in().q;
  bench.send(command(Motion::kRetrace));
  bool none = false;
  for (int i = 0; i < 3000; ++i) {
    bench.tick();
    none |= bench.out().reason == Reason::kNoTrace;
    ASSERT_LT((bench.in().q - here).cwiseAbs().maxCoeff(), 5e-3);
  }
  EXPECT_TRUE(none);
}

/// 'resume' at any time of the ramp takes over the velocity that there is, on an arm so weak that
/// even what counts as rest would be too much to drop in one cycle.
TEST(ControllerMoves, AResumeAtAnyTimeOfTheRampKeepsTheJointsAcceleration) {
  constexpr double kWeak = 0.5;     // [rad/s^2]
  constexpr double kAtRest = 5e-3;  // [rad/s] what the controller takes for rest
  RobotConfig robot = robot_behind(good_robot());
  robot.acceleration.setConstant(kWeak);
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    double worst = 0;
    for (const int after : {-30, -10, 0, 1, 2, 3}) {  // cycles after the arm counts as at rest
      Bench bench({law}, 0, 0, 0, &robot);
      for (int i = 0; i < 400; ++i) bench.ask(command(Motion::kServoCv, Vector3(0.03, 0, 0)));
      bench.controller().request(StateCommand::kPause);
      JointVector last = bench.in().qd;
      const auto tick = [&] {
        bench.tick();
        worst = std::max(worst, (bench.in().qd - last).cwiseAbs().maxCoeff() / (kT * kWeak));
        last = bench.in().qd;
      };
      const double until = kAtRest + std::max(-after, 0) * kT * kWeak;
      while (last.cwiseAbs().maxCoeff() >= until) tick();
      for (int i = 0; i < after; ++i) tick();
      ASSERT_EQ(bench.controller().request(StateCommand::kResume), Reason::kNone);
      for (int i = 0; i < 100; ++i) tick();
    }
    EXPECT_LT(worst, 1.001) << "law " << static_cast<int>(law);
  }
}

}  // namespace
}  // namespace surg
