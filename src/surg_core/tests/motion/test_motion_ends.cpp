// Every motion comes to an end that its sender can see, and its sender holds the arm until then:
// moves into a joint limit, the way back along the trace, roll beyond its range.
#include <algorithm>

#include "support/controller_bench.hpp"
#include "support/test_support.hpp"

namespace surg {
namespace {

using namespace test;

/// Moves to a place some way off, so that there is a trace.
void go_somewhere(Bench& bench) {
  bench.send(bench.pose(Motion::kMoveCp, Vector3(0.03, -0.02, 0.15), 0.5));
  do bench.tick();
  while (bench.out().busy);
}

/// Sends 'strange' from another node in every cycle until it is accepted, and expects that to
/// happen once the arm has rested for 0.5 s. Returns the duration of the motion [s].
double expect_held_until_rested(Bench& bench, const MotionCommand& strange) {
  long rested = 0, n = 0;
  for (; n < 20000; ++n) {
    bench.ask(strange);
    if (bench.out().verdicts[0].reason == Reason::kNone) break;
    if (bench.out().busy) {
      EXPECT_EQ(bench.out().source, kMe);
    }
    rested = bench.out().busy ? 0 : rested + 1;
  }
  EXPECT_NEAR(rested * kT, 0.5, 0.02) << "the other node was accepted in motion";
  return n * kT - 0.5;
}

TEST(MotionEnds, F26TheHolderKeepsTheArmThroughARetrace) {
  Bench bench;
  go_somewhere(bench);
  bench.ask(command(Motion::kRetrace));
  MotionCommand strange = command(Motion::kMoveCp, kOther);
  strange.p = Vector3(0, 0, 0.12);
  EXPECT_GT(expect_held_until_rested(bench, strange), 1.0);
}

TEST(MotionEnds, F26TheHolderKeepsTheArmWhileItsJawMoves) {
  Bench bench;
  bench.in().jaw = bench.out().jaw_set;
  MotionCommand open = command(Motion::kJawMoveJp);
  open.jaw = 1.0;
  bench.send(open);  // 0.33 s at 3 rad/s, and 0.5 s until a jaw that holds something is given up
  bench.tick();
  MotionCommand strange = command(Motion::kJawMoveJp, kOther);
  EXPECT_GT(expect_held_until_rested(bench, strange), 0.8);
}

TEST(MotionEnds, F26HalfASecondOfRestCountsFromTheEndOfAMove) {
  Bench bench;
  bench.ask(bench.pose(Motion::kMoveCp, Vector3(0.05, 0, 0.12), 0));
  EXPECT_GT(expect_held_until_rested(bench, command(Motion::kRetrace, kOther)), 0.5);
}

struct Ending {
  double stood = 0;  ///< [s] from standstill until the motion was over
  bool arrived = false, over = false;
  Reason reason = Reason::kNone;  ///< said in the cycle in which it was over
  const char* limited_by = "";
};

/// Runs the motion that was just accepted to its end. Standstill is what the plant's joints do.
Ending end_of(Bench& bench, double longest = 30) {
  Ending out;
  double since = 0;
  for (double t = 0; t < longest && !out.over; t += kT) {
    bench.tick();
    since = bench.in().qd.cwiseAbs().maxCoeff() > 1e-3 ? 0 : since + kT;
    out.over = bench.out().motion == Motion::kNone;
  }
  out.stood = since;
  out.reason = bench.out().reason;
  out.limited_by = bench.out().limited_by;
  if (out.reason == Reason::kNone) {  // behind lag, or on the way back to a path that it left
    for (int i = 0; i < 500; ++i) bench.tick();
  }
  const double turned = std::abs(bench.out().roll_goal - bench.out().roll);
  out.arrived = (bench.out().p_goal - bench.out().p_BTip).norm() < 6e-4 && turned < 0.011;
  return out;
}

/// One joint's range ends a little beside home.
RobotConfig narrow_robot(int joint, int side, double room) {
  RobotConfig robot = robot_behind(good_robot());
  (side > 0 ? robot.position_max : robot.position_min)[joint] = robot.home[joint] + side * room;
  return robot;
}

TEST(MotionEnds, F20AMoveIntoAJointLimitEndsWithAReasonWithinTwoSeconds) {
  Random random(31);
  const int n = family(60, 3000);
  long stopped = 0, arrived = 0, over = 0;
  double longest = 0;
  for (int i = 0; i < n; ++i) {
    const int side = random.integer(0, 1) == 0 ? -1 : 1;
    const RobotConfig robot = narrow_robot(random.integer(0, 5), side, random.uniform(0.02, 0.15));
    Controller::Options options;
    options.law = i % 3 == 0 ? Law::kVelocity : Law::kExact;
    const double lag = i % 2 == 0 ? 0 : 0.008;
    Bench bench(options, 0, lag, lag, &robot);
    const Vector3 p(random.uniform(-0.08, 0.08), random.uniform(-0.08, 0.08),
                    random.uniform(0.08, 0.19));
    MotionCommand to = bench.pose(Motion::kMoveCp, p, random.uniform(-2, 2));
    const Motion kinds[] = {Motion::kMoveCp, Motion::kInterpolateCp, Motion::kMoveJp};
    to.motion = kinds[random.integer(0, 2)];
    to.joints =
        Vector4(random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), p.z(), random.uniform(-2, 2));
    ASSERT_EQ(bench.ask(to), Reason::kNone);
    const Ending end = end_of(bench);
    over += end.over;
    ASSERT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
    ASSERT_LT(bench.out().rcm_error, 3e-4);
    longest = std::max(longest, end.stood);
    if (end.arrived) {
      ++arrived;
      continue;
    }
    ++stopped;
    EXPECT_EQ(end.reason, Reason::kNotArrived) << name(end.reason);
    EXPECT_STRNE(end.limited_by, "");
    // The arm obeys again: back to where it came from.
    EXPECT_EQ(bench.ask(command(Motion::kRetrace)), Reason::kNone);
    EXPECT_TRUE(end_of(bench).over);
    EXPECT_LT((bench.in().q - robot.home).cwiseAbs().maxCoeff(), 2e-3);
  }
  EXPECT_EQ(over, n) << "motions that never end";
  EXPECT_LT(longest, 2.0);
  EXPECT_GT(stopped, n / 10);
  EXPECT_GT(arrived, n / 10);
  std::printf(
      "[ figures  ] %ld arrived, %ld stopped at a limit, %ld still busy after 30 s; over at "
      "most %.2f s after standstill\n",
      arrived, stopped, n - over, longest);
}

/// A slow profile is no standstill: its first second may go a hundredth of a millimetre.
TEST(MotionEnds, ASlowMoveThatNothingLimitsIsNotGivenUp) {
  RobotConfig robot = robot_behind(good_robot());
  robot.tuning.profiler_duration = 5;
  Bench bench({}, 0, 0, 0, &robot);
  const Vector3 to = bench.tip_in_R() + Vector3(0.001, 0, 0);
  bench.ask(bench.pose(Motion::kMoveCp, to, 0));
  const Ending end = end_of(bench);
  EXPECT_TRUE(end.over);
  EXPECT_LT((bench.tip_in_R() - to).norm(), 1e-5);
}

/// A trocar that goes round keeps the joints in motion for ever; the way back ends all the same.
TEST(MotionEnds, ARetraceBehindAMovingTrocarEnds) {
  Bench bench(tracking());
  const Vector3 p0 = bench.out().p_BRcm;
  const Matrix3 R_BR = bench.controller().X_BR().linear();
  double t = 0;
  const auto tick = [&] {
    t += kT;
    const double w = M_PI, r = 0.004;
    bench.track(p0 + r * (R_BR * Vector3(std::sin(w * t), 1 - std::cos(w * t), 0)),
                r * w * (R_BR * Vector3(std::cos(w * t), std::sin(w * t), 0)));
    bench.tick();
  };
  bench.send(bench.pose(Motion::kMoveCp, Vector3(0.03, -0.02, 0.15), 0.5));
  do tick();
  while (bench.out().busy && t < 20);
  bench.send(command(Motion::kRetrace));
  const double began = t;
  do tick();
  while (bench.out().busy && t < began + 30);
  EXPECT_FALSE(bench.out().busy);
  EXPECT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
  EXPECT_LT(t - began, 15);
  for (int i = 0; i < 500; ++i) tick();
  EXPECT_LT(bench.out().rcm_error, 1e-4);
}

/// Where the trace leads beyond a limit that has come nearer since, the way back ends with a
/// reason.
TEST(MotionEnds, ARetraceThatIsBlockedEndsWithAReason) {
  Bench bench;
  go_somewhere(bench);
  bench.ask(command(Motion::kRetrace));
  long held = 0;
  Reason said = Reason::kNone;
  while (bench.out().busy && held < 10000) {
    const JointVector stuck = bench.in().q;  // a clamp: the arm is within 10 mm of its set-point
    bench.tick();
    if (bench.out().reason != Reason::kNone) said = bench.out().reason;
    bench.in().q = stuck;
    bench.in().qd.setZero();
    ++held;
  }
  EXPECT_FALSE(bench.out().busy);
  EXPECT_NE(said, Reason::kNone);
}

TEST(MotionEnds, RollHasARange) {
  const double most = robot_behind(good_robot()).limits.roll_max;
  for (const double roll : {1e5, -1e5, most + 0.01, -most - 0.01}) {
    for (const Motion motion :
         {Motion::kMoveJp, Motion::kInterpolateJp, Motion::kServoJp, Motion::kMoveJr}) {
      Bench bench;
      MotionCommand far = command(motion);
      far.joints = Vector4(0, 0, motion == Motion::kMoveJr ? 0 : 0.12, roll);
      EXPECT_EQ(bench.ask(far), Reason::kOutsideWorkspace);
      for (int i = 0; i < 50; ++i) bench.tick();
      EXPECT_LT(bench.in().qd.norm(), 1e-6);
    }
  }
  Bench bench;
  MotionCommand inside = command(Motion::kMoveJp);
  inside.joints = Vector4(0, 0, 0.12, most - 0.01);
  EXPECT_EQ(bench.ask(inside), Reason::kNone);
}

/// A stream of turns that goes on beyond the range is refused there, and may come back.
TEST(MotionEnds, AStreamMayRollBackIntoTheRange) {
  Document document = good_robot();
  document.values["limits.roll_max"] = 1.0;
  const RobotConfig robot = robot_behind(document);
  Bench bench({}, 0, 0, 0, &robot);
  const auto roll_to = [&](double roll) {
    bench.servo_cp(Vector3(0, 0, 0.12), roll);
    return bench.tick().verdicts[0].reason;
  };
  for (double roll = 0; roll < 1.0; roll += 0.0004) ASSERT_EQ(roll_to(roll), Reason::kNone);
  EXPECT_EQ(roll_to(1.003), Reason::kOutsideWorkspace);
  EXPECT_EQ(roll_to(0.999), Reason::kNone);
  // A velocity ends there as well.
  for (int i = 0; i < 60; ++i) bench.tick();
  MotionCommand turn = command(Motion::kServoCv);
  turn.roll_rate = 0.5;
  for (int i = 0; i < 200; ++i) bench.ask(turn);
  for (int i = 0; i < 300; ++i) bench.tick();
  EXPECT_NEAR(bench.out().roll, 1.0, 0.01);
  EXPECT_EQ(roll_to(0.99), Reason::kNone);
}

}  // namespace
}  // namespace surg
