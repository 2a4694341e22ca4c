// The command surface beyond streams in space: joints of the trocar frame, in and out through the
// trocar, a moving trocar, exclusive authority, the jaw and its link.
#include "support/controller_bench.hpp"
#include "support/test_support.hpp"
#include "surg_core/limits/workspace.hpp"

namespace surg {
namespace {

using namespace test;

/// Ticks until the arm is no longer busy; how many.
int wait(Bench& bench, int most = 4000) {
  int n = 0;
  while (bench.out().busy && n < most) {
    bench.tick();
    ++n;
  }
  EXPECT_LT(n, most);
  return n;
}

TEST(Surface, JointTargetsAreReachedAndTheTipTurnsOnASphere) {
  Random random(21);
  const int n = family(30, 2000);
  for (int i = 0; i < n; ++i) {
    Bench bench;
    const Vector4 target(random.uniform(-0.4, 0.4), random.uniform(-0.4, 0.4), 0.12,
                         random.uniform(-1, 1));
    EXPECT_EQ(bench.ask(joints(Motion::kMoveJp, target)), Reason::kNone);
    EXPECT_TRUE(bench.out().busy);
    while (bench.out().busy) {
      bench.tick();
      // The depth is one of the joints: between two equal depths it must not change.
      ASSERT_NEAR(bench.out().depth, 0.12, 2e-4);
      ASSERT_LT(bench.out().rcm_error, 5e-5);
    }
    EXPECT_LT((bench.out().virtual_q - target).norm(), 5e-3);
    EXPECT_LT((bench.tip_in_R() - 0.12 * shaft_direction(target[0], target[1])).norm(), 6e-4);
  }
  report("joint targets", n);
}

TEST(Surface, RelativeJointsAddToTheGoal) {
  Bench bench;
  for (int i = 0; i < 3; ++i) {
    bench.ask(joints(Motion::kMoveJr, Vector4(0.1, 0, 0.005, 0.2)));
    for (int k = 0; k < 20; ++k) bench.tick();  // the next one comes while this one is under way
  }
  wait(bench);
  EXPECT_LT((bench.out().virtual_q - Vector4(0.3, 0, 0.135, 0.6)).norm(), 5e-3);
  for (int i = 0; i < 200; ++i) {
    ASSERT_EQ(bench.ask(joints(Motion::kServoJr, Vector4(-0.0005, 0, 0, 0))), Reason::kNone);
  }
  for (int k = 0; k < 300; ++k) bench.tick();
  EXPECT_NEAR(bench.out().virtual_q[0], 0.2, 1e-2);
}

TEST(Surface, AWayThatLeavesTheWorkspaceIsRefusedThoughItsEndsAreInside) {
  Bench bench;
  bench.ask(joints(Motion::kMoveJp, Vector4(1.0, 0, 0.035, 0)));
  wait(bench);
  // The straight line between two shallow points on opposite sides passes above depth_min.
  EXPECT_EQ(bench.ask(bench.pose(Motion::kMoveCp, 0.035 * shaft_direction(-1.0, 0))),
            Reason::kOutsideWorkspace);
  bench.send(joints(Motion::kMoveJp, Vector4(-1.0, 0, 0.035, 0)));  // round it there is a way
  EXPECT_EQ(bench.tick().verdicts[0].reason, Reason::kNone);
  wait(bench);
  EXPECT_NEAR(bench.out().virtual_q[0], -1.0, 5e-3);
}

TEST(Surface, OutThroughTheTrocarAndInAgain) {  // F24
  Bench bench;
  EXPECT_EQ(bench.ask(command(Motion::kWithdraw)), Reason::kNone);
  double fastest = 0, worst = 0;
  const Vector3 s = bench.out().s_B;
  while (bench.out().busy) {
    bench.tick();
    fastest = std::max(fastest, bench.out().twist_command.head<3>().norm());
    worst = std::max(worst, bench.out().rcm_error);
    ASSERT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
  }
  EXPECT_NEAR(bench.out().depth, -0.01, 1e-3);
  EXPECT_LT(fastest, 0.0205);
  EXPECT_LT(worst, 1e-5);
  EXPECT_LT((bench.out().s_B - s).norm(), 1e-6);  // it does not turn on the way
  EXPECT_NEAR(bench.out().virtual_set[2], -0.01, 1e-3);
  // Outside nothing but the way in is taken.
  for (const Motion motion : {Motion::kServoCv, Motion::kServoJv, Motion::kMoveCp}) {
    EXPECT_EQ(bench.ask(command(motion, Vector3(0, 0, 0.1))), Reason::kNotInserted);
  }
  bench.ask(command(Motion::kInsert));
  wait(bench);
  EXPECT_NEAR(bench.out().depth, bench.robot().limits.depth_slow, 1e-3);
  MotionCommand work = command(Motion::kMoveCp, Vector3(0.01, 0, 0.1));
  EXPECT_EQ(bench.ask(work), Reason::kNone);
  wait(bench);
  EXPECT_LT((bench.tip_in_R() - work.p).norm(), 1e-3);
}

TEST(Surface, ASessionMayBeginAboveTheTrocar) {
  Bench bench;
  bench.controller().request(StateCommand::kDisable);
  bench.tick();
  const Vector3 p = bench.out().p_BTip + 0.03 * bench.out().s_B;  // 30 mm in front of the tip
  EXPECT_EQ(bench.controller().set_rcm(p), Reason::kNone);
  bench.tick();
  EXPECT_EQ(bench.controller().request(StateCommand::kEnable), Reason::kNone);
  EXPECT_EQ(bench.controller().request(StateCommand::kHome), Reason::kNone);
  bench.tick();
  EXPECT_EQ(bench.ask(command(Motion::kInsert)), Reason::kNone);
  wait(bench);
  EXPECT_NEAR(bench.out().depth, 0.03, 1e-3);
  EXPECT_EQ(bench.out().state, State::kEnabled);
}

TEST(Surface, HoldEndsTheWayOutAndTheTrocarIsWatchedAgainOnceInserted) {
  Bench bench;
  bench.send(command(Motion::kWithdraw));
  for (int i = 0; i < 500; ++i) bench.tick();
  EXPECT_TRUE(bench.out().busy);
  bench.send(command(Motion::kHold, kOther));
  for (int i = 0; i < 100; ++i) bench.tick();
  EXPECT_FALSE(bench.out().busy);
  const double depth = bench.out().depth;
  EXPECT_GT(depth, 0.08);
  for (int i = 0; i < 100; ++i) bench.tick();
  EXPECT_NEAR(bench.out().depth, depth, 1e-5);
}

TEST(Surface, TheWayBackAlongTheTraceKeepsThePivotAndEndsWhereItBegan) {
  Random random(22);
  const int n = family(4, 100);
  for (int run = 0; run < n; ++run) {
    Bench bench;
    for (int i = 0; i < 10; ++i) bench.tick();
    const JointVector home = bench.in().q;
    for (int move = 0; move < 3; ++move) {
      const Vector3 to(random.uniform(-0.03, 0.03), random.uniform(-0.03, 0.03),
                       random.uniform(0.09, 0.15));
      bench.ask(bench.pose(Motion::kMoveCp, to, random.uniform(-1, 1)));
      wait(bench);
    }
    EXPECT_GT((bench.in().q - home).norm(), 0.02);
    EXPECT_EQ(bench.ask(command(Motion::kRetrace)), Reason::kNone);
    EXPECT_TRUE(bench.out().busy);
    int cycles = 0;
    double worst = 0;
    while (bench.out().busy && cycles < 30000) {
      bench.tick();
      worst = std::max(worst, bench.out().rcm_error);
      ++cycles;
      ASSERT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
    }
    EXPECT_LT(cycles, 30000);
    EXPECT_LT(worst, 1e-6);
    EXPECT_LT((bench.in().q - home).cwiseAbs().maxCoeff(), 2e-3) << "run " << run;
    // There is nothing left to go back along, and a new command is taken at once.
    bench.send(command(Motion::kRetrace));
    for (int i = 0; i < 5; ++i) bench.tick();
    EXPECT_FALSE(bench.out().busy);
    bench.servo_cp(bench.tip_in_R(), bench.out().roll);
    EXPECT_EQ(bench.tick().verdicts[0].reason, Reason::kNone);
  }
  report("ways back", n);
}

TEST(Surface, HoldEndsTheWayBack) {
  Bench bench;
  bench.ask(command(Motion::kMoveCp, Vector3(0.03, 0.02, 0.14)));
  wait(bench);
  bench.send(command(Motion::kRetrace));
  for (int i = 0; i < 100; ++i) bench.tick();
  EXPECT_TRUE(bench.out().busy);
  bench.send(command(Motion::kHold, kOther));
  for (int i = 0; i < 200; ++i) bench.tick();
  EXPECT_FALSE(bench.out().busy);
  EXPECT_LT(bench.out().qd_command.norm(), 1e-4);
  EXPECT_EQ(bench.out().state, State::kEnabled);
}

/// The guaranteed way out must be there after what may happen on any way: the arm is stopped in the
/// middle of it, or in full motion, and comes to rest elsewhere than where the trace ended.
TEST(Surface, TheWayBackOutlivesPausesAndFaults) {
  enum class Stop { kPausedOnTheWayBack, kPausedInMotion, kLinkLostOnTheWayBack, kHeld };
  long ways = 0;
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const Stop stop : {Stop::kPausedOnTheWayBack, Stop::kPausedInMotion,
                            Stop::kLinkLostOnTheWayBack, Stop::kHeld}) {
      Bench bench({law});
      for (int i = 0; i < 10; ++i) bench.tick();
      const JointVector home = bench.in().q;
      for (const Vector3& p : {Vector3(0.03, 0.02, 0.14), Vector3(-0.03, 0.02, 0.1)}) {
        bench.ask(command(Motion::kMoveCp, p));
        wait(bench);
      }
      if (stop == Stop::kPausedInMotion) {
        for (int i = 0; i < 150; ++i) bench.ask(command(Motion::kServoCv, Vector3(0.25, 0, 0)));
      } else {
        bench.send(command(Motion::kRetrace));
        for (int i = 0; i < 1000; ++i) bench.tick();
        ASSERT_TRUE(bench.out().busy);
      }
      const JointVector before = bench.in().q;
      StateCommand again = StateCommand::kResume;
      if (stop == Stop::kHeld) {
        bench.send(command(Motion::kHold));
      } else if (stop == Stop::kLinkLostOnTheWayBack) {
        bench.in().state_valid = false;
        again = StateCommand::kEnable;
      } else {
        bench.controller().pause(Reason::kForce);
      }
      for (int i = 0; i < 200; ++i) bench.tick();
      if (stop == Stop::kPausedInMotion) {
        EXPECT_GT((bench.in().q - before).cwiseAbs().maxCoeff(), 0.02) << "too slow to tell";
      }
      bench.in().state_valid = true;
      bench.tick();
      if (stop == Stop::kLinkLostOnTheWayBack) bench.controller().request(StateCommand::kDisable);
      if (stop != Stop::kHeld) {
        EXPECT_EQ(bench.controller().request(again), Reason::kNone);
      }
      bench.send(command(Motion::kRetrace));  // in the first cycle
      EXPECT_EQ(bench.tick().verdicts[0].reason, Reason::kNone);
      EXPECT_EQ(bench.out().reason, Reason::kNone) << name(bench.out().reason);
      EXPECT_TRUE(bench.out().busy);
      double pivot = 0;
      for (int i = 0; i < 30000 && bench.out().busy; ++i) {
        bench.tick();
        pivot = std::max(pivot, bench.out().rcm_error);
      }
      EXPECT_LT(pivot, 1e-6);
      EXPECT_LT((bench.in().q - home).cwiseAbs().maxCoeff(), 2e-3);
      EXPECT_EQ(bench.out().state, State::kEnabled);
      // Said in the very next cycle as well.
      bench.ask(command(Motion::kRetrace));
      EXPECT_EQ(bench.out().reason, Reason::kNoTrace);
      ++ways;
    }
  }
  report("ways back that were stopped", ways);
}

/// What was gone back is no part of the way out, whatever the trocar has done since: the tip must
/// not go in again to begin with.
TEST(Surface, AWayBackThatWasHeldDoesNotLeadInAgain) {
  Bench bench(tracking());
  const Vector3 p_BRcm = bench.out().p_BRcm, across = bench.controller().X_BR().linear().col(0);
  double at = 0;  // [m] the trocar is pushed aside, by 9 mm in all
  const auto tick = [&](double speed = 0) {
    at += kT * speed;
    bench.track(p_BRcm + at * across, speed * across, 0);
    bench.tick();
  };
  const auto rest = [&] {
    for (int i = 0; i < 20000 && bench.out().busy; ++i) tick();
  };
  tick();
  bench.send(command(Motion::kMoveCp, Vector3(0, 0, 0.2)));
  tick();
  rest();
  bench.send(command(Motion::kRetrace));
  for (int i = 0; i < 600; ++i) tick(0.0075);
  ASSERT_TRUE(bench.out().busy) << name(bench.out().reason);
  bench.send(command(Motion::kHold));
  for (int i = 0; i < 200; ++i) tick();
  const double depth = bench.out().depth;
  EXPECT_LT(depth, 0.19);
  EXPECT_GT(depth, 0.13);
  bench.send(command(Motion::kRetrace));
  double deepest = 0;
  tick();
  for (int i = 0; i < 30000 && bench.out().busy; ++i) {
    tick();
    deepest = std::max(deepest, bench.out().depth);
  }
  EXPECT_EQ(bench.out().state, State::kEnabled);
  EXPECT_LT(deepest, depth + 0.002);
  EXPECT_LT(bench.out().depth, 0.13);  // where it began, seen from the trocar's new place
}

/// Trocar that breathes: 5 mm at 0.25 Hz across the shaft.
struct Breathing {
  Vector3 p0, across;
  Vector3 p(double t) const { return p0 + 0.005 * std::sin(0.5 * M_PI * t) * across; }
  Vector3 v(double t) const { return 0.005 * 0.5 * M_PI * std::cos(0.5 * M_PI * t) * across; }
};

struct MovingTrocar {
  double pivot, tip;  // [m] mean deviation of the pivot, worst of the tip
};

MovingTrocar on_moving_trocar(bool aware, double stale) {
  Bench bench(tracking(aware));
  const Breathing trocar{bench.out().p_BRcm, bench.controller().X_BR().linear().col(0)};
  double sum = 0, worst_tip = 0;
  int n = 0;
  for (int i = 0; i < 4000; ++i) {
    const double t = i * kT;
    bench.in().track_valid = aware;
    bench.in().track_age = stale;
    bench.in().p_BTrack = trocar.p(t - stale);
    bench.in().v_BTrack = trocar.v(t - stale);
    const Vector3 p(0.02 * std::sin(std::min(1.0, t) * t), 0, 0.12);
    bench.servo_cp(p);
    bench.tick();
    const Outputs& out = bench.out();
    const Vector3 to = trocar.p(t) - out.p_BTip;
    if (t > 1) {
      worst_tip = std::max(worst_tip, (bench.tip_in_R() - p).norm());
      sum += (to - out.s_B * out.s_B.dot(to)).norm();
      ++n;
    }
    EXPECT_EQ(out.state, State::kEnabled);
    if (out.state != State::kEnabled) break;
  }
  return {sum / n, worst_tip};
}

TEST(Surface, AMovingTrocarIsFollowedThoughItsSamplesAreStale) {
  const MovingTrocar aware = on_moving_trocar(true, 0.02), unaware = on_moving_trocar(false, 0.02);
  std::printf("mean true deviation: aware %.2f um, unaware %.0f um; tip: %.0f and %.0f um\n",
              1e6 * aware.pivot, 1e6 * unaware.pivot, 1e6 * aware.tip, 1e6 * unaware.tip);
  EXPECT_LT(aware.pivot, 5e-6);
  EXPECT_GT(unaware.pivot, 1e-3);
  EXPECT_LT(aware.tip, unaware.tip + 20e-6);  // the tip does not sway with its trocar
}

/// A tracker that is switched on in the middle of a breath: faster within a cycle than the joints
/// can be. The pivot must not jump, and the tip stands still.
TEST(Surface, ATrocarThatSetsOutAtOnceIsCaughtUpWith) {
  Random random(23);
  const int n = family(12, 300);
  double worst_tip = 0;
  long off_path = 0;
  for (int run = 0; run < n; ++run) {
    Bench bench(tracking());
    const Vector3 p_BRcm = bench.out().p_BRcm, p_BTip = bench.out().p_BTip;
    const double around = random.uniform(-M_PI, M_PI), speed = random.uniform(0.002, 0.012);
    const Vector3 v = bench.controller().X_BR().linear() *
                      Vector3(speed * std::cos(around), speed * std::sin(around), 0);
    const int cycles = static_cast<int>(0.009 / speed / kT);
    for (int i = 1; i <= cycles; ++i) {
      bench.track(p_BRcm + i * kT * v, v);
      bench.tick();
      ASSERT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
      off_path += bench.out().tier > 0;
      worst_tip = std::max(worst_tip, (bench.out().p_BTip - p_BTip).norm());
    }
    ASSERT_EQ(bench.out().tier, 0);
    ASSERT_LT((bench.out().p_BTip - p_BTip).norm(), 2e-4);
  }
  EXPECT_LE(off_path, n / 100) << "the correction shall fade in";
  EXPECT_LT(worst_tip, 1e-4);
  std::printf("[   count  ] %d trocars, %ld cycles off the path, tip %.0f um\n", n, off_path,
              worst_tip * 1e6);
}

/// An arm that moves 12 ms after it was told meets the trocar where it will be then.
TEST(Surface, AMovingTrocarIsMetWhereItWillBeWhenTheArmMoves) {
  Bench bench(tracking(), 2, 0.008, 0.012);
  const Breathing trocar{bench.out().p_BRcm, bench.controller().X_BR().linear().col(0)};
  double worst = 0;
  for (int i = 0; i < 6000; ++i) {
    const double t = i * kT;
    bench.track(trocar.p(t), trocar.v(t));
    bench.tick();
    ASSERT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
    const Vector3 to = trocar.p(t) - bench.out().p_BTip;
    const Vector3 s = bench.out().s_B;
    if (t > 2) worst = std::max(worst, (to - s * s.dot(to)).norm());
  }
  std::printf("lagging arm on a breathing trocar: %.0f um\n", 1e6 * worst);
  EXPECT_LT(worst, 4e-5);  // 94 um without the link's delay
}

TEST(Surface, ATrackOutOfItsBoundsFaultsAndASilentOnePauses) {  // F23
  struct Case {
    Vector3 offset, velocity;  // [m] at once, [m/s] from then on
    double age;
    State state;
    Reason reason;
  };
  const Case cases[] = {
      {{0.0101, 0, 0}, {0, 0, 0}, 0, State::kFault, Reason::kRcmError},
      {{0, 0, 0}, {0, 0.03, 0}, 0, State::kFault, Reason::kRcmError},
      {{0, 0, 0}, {0, 1e308, 0}, 0, State::kFault, Reason::kNotFinite},
      {{0, 0, 0}, {0, NAN, 0}, 0, State::kFault, Reason::kNotFinite},
      {{NAN, 0, 0}, {0, 0, 0}, 0, State::kFault, Reason::kNotFinite},
      {{0, 0, 0}, {0, 0, 0}, 0.251, State::kPaused, Reason::kTrackStale},
      {{0, 0, 0}, {0, 0, 0}, NAN, State::kFault, Reason::kNotFinite},
  };
  for (const Case& c : cases) {
    Bench bench(tracking());
    const Vector3 p_BRcm = bench.out().p_BRcm;
    const auto track = [&](const Vector3& p, const Vector3& v, double age) {
      bench.track(p, v, age);
      bench.tick();
    };
    for (int i = 0; i < 100; ++i) track(p_BRcm, Vector3::Zero(), 0);
    ASSERT_EQ(bench.out().state, State::kEnabled);
    // One sample alone may be an outlier: the offset and the speed have to last.
    for (int i = 0; i < 140 && bench.out().state == State::kEnabled; ++i) {
      track(p_BRcm + c.offset + i * kT * c.velocity, c.velocity, c.age);
    }
    EXPECT_EQ(bench.out().state, c.state);
    EXPECT_EQ(bench.out().reason, c.reason) << name(bench.out().reason);
    EXPECT_TRUE(bench.out().qd_command.allFinite());
    // Good samples count again, whatever came before.
    for (int i = 0; i < 140; ++i) track(p_BRcm, Vector3::Zero(), 0.001);
    bench.controller().request(StateCommand::kDisable);
    EXPECT_EQ(bench.controller().request(StateCommand::kEnable), Reason::kNone);
    for (int i = 0; i < 5; ++i) track(p_BRcm, Vector3::Zero(), 0.001);
    EXPECT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
  }
}

TEST(Surface, F23ATrackThatCreepsAwayFaultsAtItsRange) {
  const Vector3 creep(0.008, 0.006, 0);  // [m/s] slower than the trocar's speed limit
  for (const bool outside_at_once : {false, true}) {
    Bench bench(tracking());
    const Vector3 p_BTaught = bench.out().p_BRcm;
    const Vector3 start = outside_at_once ? Vector3(0.0101, 0, 0) : Vector3::Zero();
    Vector3 moved = Vector3::Zero();
    for (int i = 0; i < 1000 && bench.out().state == State::kEnabled; ++i) {
      moved = start + i * kT * creep;
      bench.track(p_BTaught + moved, creep);
      bench.tick();
    }
    EXPECT_EQ(bench.out().state, State::kFault);
    EXPECT_EQ(bench.out().reason, Reason::kRcmError) << name(bench.out().reason);
    EXPECT_NEAR(moved.norm(), outside_at_once ? 0.0101 : 0.010, 2e-4);
  }
}

TEST(Surface, AClaimHoldsThroughRestAndEndsWithEnabled) {
  Bench bench;
  EXPECT_EQ(bench.controller().claim(kOther), Reason::kNone);
  EXPECT_EQ(bench.controller().claim(kMe), Reason::kNoAuthority);
  for (int i = 0; i < 1000; ++i) bench.tick();  // two seconds of rest do not free it
  bench.servo_cp(bench.tip_in_R());
  EXPECT_EQ(bench.tick().verdicts[0].reason, Reason::kNoAuthority);
  EXPECT_EQ(bench.controller().request(StateCommand::kPause), Reason::kNone);
  bench.tick();
  EXPECT_EQ(bench.controller().claim(kMe), Reason::kNone);
  EXPECT_EQ(bench.controller().request(StateCommand::kResume), Reason::kNone);
  bench.tick();
  bench.servo_cp(bench.tip_in_R());
  EXPECT_EQ(bench.tick().verdicts[0].reason, Reason::kNone);
  bench.servo_cp(bench.tip_in_R(), 0, kOther);
  EXPECT_EQ(bench.tick().verdicts[0].reason, Reason::kNoAuthority);
}

TEST(Surface, TheJawIsBusyUntilItIsThereAndMovesOnCommandOnly) {  // F31
  Bench bench;
  bench.in().jaw = bench.out().jaw_set;
  MotionCommand open = command(Motion::kJawMoveJp);
  open.jaw = 0.6;
  bench.send(open);
  EXPECT_TRUE(bench.tick().busy);
  int n = 0;
  while (bench.out().busy && n < 1000) {
    bench.in().jaw = bench.out().jaw_set;
    bench.tick();
    ++n;
  }
  EXPECT_NEAR(bench.out().jaw_set, 0.6, 1e-9);
  EXPECT_NEAR(n * kT, 0.2, 0.02);
  bench.send(open);  // zero length: still an edge
  EXPECT_TRUE(bench.tick().busy);
  // The tool link falls silent on the way: neither jaw nor arm goes on, nor starts by itself.
  open.jaw = 0.1;
  bench.ask(open);
  bench.send(command(Motion::kMoveCp, Vector3(0.03, 0, 0.12)));
  for (int i = 0; i < 20; ++i) bench.tick();
  bench.in().jaw_age = 0.201;
  bench.tick();
  const double jaw = bench.out().jaw_set;
  EXPECT_EQ(bench.out().reason, Reason::kToolLost);
  for (int i = 0; i < 300; ++i) bench.tick();
  EXPECT_EQ(bench.out().jaw_set, jaw);
  EXPECT_LT(bench.out().qd_command.norm(), 1e-6);
  EXPECT_EQ(bench.out().state, State::kEnabled);
  bench.in().jaw_age = 0;
  const Vector3 at = bench.tip_in_R();
  for (int i = 0; i < 300; ++i) bench.tick();
  EXPECT_EQ(bench.out().jaw_set, jaw);
  EXPECT_LT((bench.tip_in_R() - at).norm(), 1e-5);
}

TEST(Surface, AJawThatNobodyHasSeenIsNotBusyForEver) {
  const RobotConfig robot = Bench::robot_with_lag(0);
  Controller controller(test::ur5e_chain(), robot, robot.limits, test::instrument(),
                        test::offset_tool(), {});
  Inputs in;
  in.state_valid = true;
  in.q = robot.home;
  in.qd = JointVector::Zero(6);
  in.jaw = std::nan("");
  const Pose X_BF = test::ur5e_chain().forward(in.q);
  controller.set_rcm(X_BF * test::offset_tool().p_FTip - 0.12 * X_BF.linear().col(2));
  controller.step(in);
  EXPECT_EQ(controller.request(StateCommand::kHome), Reason::kNone);
  EXPECT_EQ(controller.request(StateCommand::kEnable), Reason::kNone);
  for (int i = 0; i < 10; ++i) controller.step(in);
  in.commands[0] = command(Motion::kJawMoveJp);
  in.n_commands = 1;
  EXPECT_TRUE(controller.step(in).busy);
  in.n_commands = 0;
  int n = 0;
  while (controller.step(in).busy && n < 1000) ++n;
  EXPECT_NEAR(n * kT, 0.5, 0.01);
}

/// Drives the tip along x against a spring wall at 5 mm; N per metre beyond.
struct Wall {
  double stiffness;
  ForceSample at(const Bench& bench) const {
    const double in = std::max(0.0, bench.tip_in_R().x() - 0.005);
    return {true, Vector3(bench.controller().X_BR().linear().col(0) * (-stiffness * in))};
  }
};

TEST(Surface, ASoftForceIsYieldedToAndPauses) {  // F25
  const Wall wall{2000};
  Bench bench;
  MotionCommand push = command(Motion::kServoCv, Vector3(0.03, 0, 0));
  int above = 0;
  double most = 0;
  while (bench.out().state == State::kEnabled && bench.ticks < 2000) {
    bench.send(push);
    bench.in().tip_force = wall.at(bench);
    above += bench.in().tip_force.f_B.norm() > 5;
    most = std::max(most, bench.in().tip_force.f_B.norm());
    bench.tick();
  }
  EXPECT_EQ(bench.out().reason, Reason::kForce);
  EXPECT_EQ(bench.out().state, State::kPaused);
  EXPECT_EQ(above, 51);  // 0.1 s, and the cycle that passes it
  // The motion into the wall ends with the first sample above, as fast as the joints can brake.
  EXPECT_LT(most, 7.5);
  // Back out it comes, with no other trick than 'resume'.
  for (int i = 0; i < 100; ++i) {
    bench.in().tip_force = wall.at(bench);
    bench.tick();
  }
  EXPECT_EQ(bench.controller().request(StateCommand::kResume), Reason::kNone);
  push.p = Vector3(-0.03, 0, 0);
  for (int i = 0; i < 300; ++i) {
    bench.send(push);
    bench.in().tip_force = wall.at(bench);
    bench.tick();
    ASSERT_EQ(bench.out().state, State::kEnabled);
  }
  EXPECT_LT(bench.tip_in_R().x(), 0);
}

TEST(Surface, AHardForceAndTheTrocarsLoadStopInTheSameCycle) {  // F25
  for (const bool at_tip : {true, false}) {
    for (const Vector3& f : {Vector3(at_tip ? 8.01 : 15.01, 0, 0), Vector3(NAN, 0, 0)}) {
      Bench bench;
      for (int i = 0; i < 200; ++i) bench.ask(command(Motion::kServoCv, Vector3(0.03, 0, 0)));
      const JointVector before = bench.out().qd_command, most = kT * bench.robot().acceleration;
      EXPECT_GT(before.norm(), 1e-3);
      (at_tip ? bench.in().tip_force : bench.in().trocar_force) = {true, f};
      bench.tick();
      EXPECT_EQ(bench.out().state, State::kFault);
      EXPECT_EQ(bench.out().reason, Reason::kForce);
      // All joints brake together as hard as the limits allow; the trocar's load ends in a ramp.
      const double cycles = std::max(1.0, (before.array().abs() / most.array()).maxCoeff());
      const JointVector faded = (1 - 1 / cycles) * before;
      const bool fades = at_tip || std::isnan(f.x());
      EXPECT_EQ((bench.out().qd_command - faded).norm() < 1e-12, fades);
      for (int i = 0; i < 50; ++i) bench.tick();
      EXPECT_EQ(bench.out().qd_command.norm(), 0);
      EXPECT_EQ(bench.controller().request(StateCommand::kEnable), Reason::kForce);
      bench.in().tip_force = bench.in().trocar_force = {};
      bench.tick();
      EXPECT_EQ(bench.controller().request(StateCommand::kEnable), Reason::kNone);
    }
  }
}

TEST(Surface, AMoveThatIsNotFollowedEndsWithAReason) {
  Bench bench;
  const JointVector stuck = bench.in().q;
  bench.send(command(Motion::kMoveCp, bench.tip_in_R() + Vector3(0.003, 0, 0)));
  bool said = false;
  for (int i = 0; i < 1500; ++i) {
    bench.tick();
    bench.in().q = stuck;
    bench.in().qd.setZero();
    said |= bench.out().reason == Reason::kNotFollowing;
  }
  EXPECT_TRUE(said);
  EXPECT_EQ(bench.out().state, State::kPaused);
  EXPECT_FALSE(bench.out().busy);
}

}  // namespace
}  // namespace surg
