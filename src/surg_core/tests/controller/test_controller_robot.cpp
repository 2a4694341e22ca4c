// F33: what the robot link says of its robot, and an arm that stands still against its commands.
#include <cmath>
#include <cstdio>

#include "support/controller_bench.hpp"
#include "support/test_support.hpp"

namespace surg {
namespace {

using namespace test;

/// A bench whose robot stops by itself, as far as its condition says.
class RobotBench : public Bench {
 public:
  using Bench::Bench;

  /// One cycle of a sideways stream of 'speed' [m/s].
  const Outputs& stream(double speed) {
    servo_cp(Vector3(x_ += speed * kT, 0, 0.12));
    return cycle();
  }
  /// One cycle; a robot that is not active stands still, whatever it is told.
  const Outputs& cycle() {
    const JointVector before = in().q;
    tick();
    if (in().condition == RobotCondition::kActive) return out();
    in().q = before;
    in().qd.setZero();
    return out();
  }

 private:
  double x_ = 0;
};

const RobotCondition kStopping[] = {RobotCondition::kOff,     RobotCondition::kBraked,
                                    RobotCondition::kReady,   RobotCondition::kGuided,
                                    RobotCondition::kStopped, RobotCondition::kEstop,
                                    RobotCondition::kBroken,  RobotCondition::kOtherCommand};

TEST(Robot, F33AConditionThatIsNotActiveFaultsAndCommandsZeroInTheSameCycle) {
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const RobotCondition condition : kStopping) {
      RobotBench bench({law});
      for (int i = 0; i < 200; ++i) bench.stream(0.012);
      ASSERT_GT(bench.out().qd_command.norm(), 1e-3);
      bench.in().condition = condition;
      bench.stream(0.012);
      EXPECT_EQ(bench.out().state, State::kFault);
      EXPECT_EQ(bench.out().reason, Reason::kRobot);
      EXPECT_EQ(bench.out().qd_command.norm(), 0);
      EXPECT_EQ(bench.out().twist_command.norm(), 0);
      EXPECT_LT((bench.out().p_set - bench.out().p_BTip).norm(), 1e-12)
          << "the set-point is dropped";
      for (const StateCommand word : {StateCommand::kEnable, StateCommand::kHome}) {
        EXPECT_EQ(bench.controller().request(word), Reason::kRobot);
      }
      EXPECT_EQ(bench.controller().request(StateCommand::kResume), Reason::kRefusedTransition);
    }
  }
}

TEST(Robot, F33WhatIsPausedFaultsToo) {
  RobotBench bench;
  bench.stream(0.012);
  ASSERT_EQ(bench.controller().request(StateCommand::kPause), Reason::kNone);
  bench.cycle();
  bench.in().condition = RobotCondition::kStopped;
  EXPECT_EQ(bench.cycle().state, State::kFault);
  EXPECT_EQ(bench.out().reason, Reason::kRobot);
  EXPECT_EQ(bench.out().qd_command.norm(), 0);
}

TEST(Robot, F33DisabledItStaysDisabledAndIsNotEnabledUntilItIsActive) {
  RobotBench bench;
  bench.controller().request(StateCommand::kDisable);
  bench.in().condition = RobotCondition::kGuided;
  bench.cycle();
  EXPECT_EQ(bench.out().state, State::kDisabled);
  EXPECT_EQ(bench.controller().request(StateCommand::kEnable), Reason::kRobot);
  EXPECT_EQ(bench.controller().request(StateCommand::kHome), Reason::kRobot);
  bench.in().condition = RobotCondition::kActive;
  bench.cycle();
  EXPECT_EQ(bench.controller().request(StateCommand::kEnable), Reason::kNone);
}

/// An arm that is unlocked stays where it is until a person enables it, and then too.
TEST(Robot, F33AfterTheUnlockNothingMovesUntilAPersonEnables) {
  Random random(33);
  const int n = family(24, 400);
  double moved = 0;
  for (int run = 0; run < n; ++run) {
    Controller::Options options;
    options.law = run % 2 ? Law::kVelocity : Law::kExact;
    RobotBench bench(options, random.integer(0, 4), random.uniform(0.001, 0.02), 0.012);
    const double speed = run % 4 < 2 ? 0.012 : 0.0012;
    for (int i = random.integer(60, 400); i > 0; --i) bench.stream(speed);
    bench.in().condition = kStopping[random.integer(0, 7)];
    // No shorter than the plant's delay: it hands on what it was told before the stop.
    for (int i = random.integer(5, 600); i > 0; --i) bench.stream(speed);
    const JointVector at = bench.in().q;
    bench.in().condition = RobotCondition::kActive;
    for (int i = 0; i < 300; ++i) {
      bench.stream(speed);
      EXPECT_EQ(bench.out().state, State::kFault);
      moved = std::max(moved, (bench.in().q - at).cwiseAbs().maxCoeff());
    }
    ASSERT_EQ(bench.controller().request(StateCommand::kEnable), Reason::kNone);
    for (int i = 0; i < 300; ++i) bench.cycle();
    EXPECT_EQ(bench.out().state, State::kEnabled);
    // Off the pivot by what it lagged when it stopped, it returns to it, and no farther.
    EXPECT_LT((bench.in().q - at).cwiseAbs().maxCoeff(), 1e-3);
  }
  EXPECT_EQ(moved, 0);
  report("robots stopped, unlocked and enabled", n);
}

TEST(Robot, F33ASlowedRobotIsRampedAndFaults) {
  RobotBench bench;
  for (int i = 0; i < 200; ++i) bench.stream(0.03);
  bench.in().condition = RobotCondition::kSlowed;
  bench.tick();
  EXPECT_EQ(bench.out().state, State::kFault);
  EXPECT_EQ(bench.out().reason, Reason::kRobot);
  EXPECT_GT(bench.out().qd_command.norm(), 1e-3) << "a ramp";
  for (int i = 0; i < 100; ++i) bench.tick();
  EXPECT_LT(bench.out().qd_command.norm(), 1e-3);
  EXPECT_EQ(bench.controller().request(StateCommand::kEnable), Reason::kRobot);
}

TEST(Robot, F33AnOldConditionIsALostLink) {
  for (const bool says_so : {false, true}) {
    RobotBench bench;
    for (int i = 0; i < 100; ++i) bench.stream(0.012);
    bench.in().condition_age = bench.robot().tuning.link_timeout + 0.04;  // two periods of 50 Hz
    EXPECT_EQ(bench.stream(0.012).state, State::kEnabled);
    if (says_so) {
      bench.in().condition = RobotCondition::kOffline;
    } else {
      bench.in().condition_age += kT;
    }
    bench.tick();
    EXPECT_EQ(bench.out().state, State::kFault);
    EXPECT_EQ(bench.out().reason, Reason::kLinkLost);
    for (int i = 0; i < 100; ++i) bench.tick();
    EXPECT_EQ(bench.out().qd_command.norm(), 0);
    EXPECT_EQ(bench.controller().request(StateCommand::kEnable), Reason::kLinkLost);
  }
}

TEST(Robot, F33UnknownNumbersOnTheWireAreABrokenRobot) {
  EXPECT_EQ(robot_condition(4), RobotCondition::kActive);
  for (const int number : {9, 10, 11, 99, 255}) {
    EXPECT_EQ(robot_condition(static_cast<std::uint8_t>(number)), RobotCondition::kBroken);
  }
}

/// Nobody drives it and nobody says where its jaw is.
TEST(Robot, APassiveInstrumentNeedsNoToolLink) {
  for (const bool passive : {false, true}) {
    RobotBench bench;
    InstrumentConfig tool = test::instrument();
    tool.jaw_min = tool.jaw_max = tool.jaw_velocity = 0;
    tool.passive = passive;
    Controller controller(bench.chain(), bench.robot(), bench.robot().limits, tool,
                          test::offset_tool(), {});
    Inputs in = bench.in();
    in.jaw = NAN;
    in.jaw_age = INFINITY;
    in.q = bench.robot().home;
    in.qd.setZero();
    controller.set_rcm(bench.out().p_BRcm);
    controller.step(in);
    controller.request(StateCommand::kHome);
    ASSERT_EQ(controller.request(StateCommand::kEnable), Reason::kNone);
    in.n_commands = 1;
    in.commands[0] = MotionCommand{};
    in.commands[0].motion = Motion::kServoCv;
    in.commands[0].source = kMe;
    in.commands[0].p = Vector3(0.01, 0, 0);
    const Outputs& out = controller.step(in);
    EXPECT_EQ(out.verdicts[0].reason, passive ? Reason::kNone : Reason::kToolLost);
    EXPECT_EQ(std::isfinite(out.jaw), passive);
    if (passive) {
      EXPECT_EQ(out.jaw_set, 0);
    }
  }
}

// --- an arm that does not move -------------------------------------------------------------------

TEST(Robot, AnArmThatNeverMovesIsNoticedUnderEveryLawAtEverySpeed) {
  for (const Law law : {Law::kExact, Law::kVelocity, Law::kPaper}) {
    for (const double speed : {0.0012, 0.012, 0.05}) {
      Bench bench({law});
      const JointVector stuck = bench.in().q;
      int noticed = 0;
      for (int i = 1; i <= 2000 && noticed == 0; ++i) {
        bench.servo_cp(Vector3(0.004 * std::sin(speed * i * kT / 0.004), 0, 0.12));
        bench.tick();
        bench.in().q = stuck;
        bench.in().qd.setZero();
        if (bench.out().state == State::kPaused) noticed = i;
      }
      EXPECT_GT(noticed, 0) << static_cast<int>(law) << " " << speed;
      EXPECT_EQ(bench.out().reason, Reason::kNotFollowing);
      EXPECT_LT(noticed * kT, speed < 0.01 ? 2.0 : 0.5) << static_cast<int>(law) << " " << speed;
      std::printf("[   value  ] law %d, %.4f m/s: not_following after %.3f s\n",
                  static_cast<int>(law), speed, noticed * kT);
    }
  }
}

/// Late links, trembling hands and reversals are no standstill.
TEST(Robot, AnArmThatLagsIsNeverTakenForOneThatStands) {
  Random random(4);
  const int n = family(40, 600);
  for (int run = 0; run < n; ++run) {
    Controller::Options options;
    options.law = run % 2 ? Law::kVelocity : Law::kExact;
    Bench bench(options, random.integer(0, 10), random.uniform(0.001, 0.02), 0.012);
    const double amplitude = std::pow(10, random.uniform(-4.5, -2.3)),
                 rate = random.uniform(0.5, std::min(60.0, 0.05 / amplitude));
    for (int i = 0; i < 2000; ++i) {
      const double phase = rate * i * kT;
      bench.servo_cp(Vector3(amplitude * std::sin(phase), amplitude * (1 - std::cos(phase)), 0.12));
      bench.tick();
      for (int k = 0; k < 6; ++k) bench.in().qd[k] += random.uniform(-1e-3, 1e-3);
      ASSERT_EQ(bench.out().state, State::kEnabled)
          << run << " " << i << " " << name(bench.out().reason) << " " << amplitude << " " << rate;
    }
  }
  report("lagging arms", n);
}

}  // namespace
}  // namespace surg
