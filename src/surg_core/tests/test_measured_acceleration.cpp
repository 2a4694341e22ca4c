// The arm's own acceleration keeps its limit whatever happens to states, cycles and the link. The
// oracle is the plant's measured motion, not the sequence of commands.
#include <algorithm>
#include <cstdio>

#include "support/timed_bench.hpp"

namespace surg {
namespace {

using namespace test;

constexpr double kRounding = 1 + 1e-6;

// --- state commands while the arm comes to rest -------------------------------------------------

/// Pauses or disables an arm in full motion, sends 'act' a few cycles later, and lets it run out.
template <typename Act>
Reason in_the_ramp(TimedBench& bench, StateCommand leave, int later, Act act) {
  bench.in_motion(0.15);
  bench.arm().forget();
  EXPECT_EQ(bench.controller().request(leave), Reason::kNone);
  for (int i = 0; i < later; ++i) bench.cycle();
  const Reason answer = act(bench.controller());
  for (int i = 0; i < 200; ++i) bench.cycle();
  return answer;
}

TEST(MeasuredAcceleration, ATrocarPointTaughtInARampDoesNotStopTheArmAtOnce) {
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const StateCommand leave : {StateCommand::kPause, StateCommand::kDisable}) {
      for (const int later : {0, 1, 5, 15}) {
        TimedBench bench(law);
        const Reason answer = in_the_ramp(bench, leave, later, [&](Controller& controller) {
          return controller.set_rcm(bench.p_BRcm());
        });
        EXPECT_LE(bench.arm().worst_acceleration(), kRounding) << later;
        EXPECT_EQ(answer, Reason::kNotAtRest) << later;
        EXPECT_TRUE(bench.out().homed);
        EXPECT_EQ(bench.controller().set_rcm(bench.p_BRcm()), Reason::kNone) << "at rest";
      }
    }
  }
}

TEST(MeasuredAcceleration, UnhomeInARampDoesNotStopTheArmAtOnce) {
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const StateCommand leave : {StateCommand::kPause, StateCommand::kDisable}) {
      for (const int later : {0, 1, 5, 15}) {
        TimedBench bench(law);
        const Reason answer = in_the_ramp(bench, leave, later, [](Controller& controller) {
          return controller.request(StateCommand::kUnhome);
        });
        EXPECT_LE(bench.arm().worst_acceleration(), kRounding) << later;
        EXPECT_EQ(answer, Reason::kNotAtRest) << later;
        EXPECT_EQ(bench.controller().request(StateCommand::kUnhome), Reason::kNone) << "at rest";
        EXPECT_FALSE(bench.cycle().homed);
      }
    }
  }
}

TEST(MeasuredAcceleration, UnhomeIsRefusedInTheRampOfAFault) {
  TimedBench bench;
  bench.in_motion(0.15);
  bench.arm().forget();
  bench.controller().fault(Reason::kMasterLost);
  bench.cycle();
  EXPECT_EQ(bench.controller().request(StateCommand::kUnhome), Reason::kNotAtRest);
  for (int i = 0; i < 200; ++i) bench.cycle();
  EXPECT_LE(bench.arm().worst_acceleration(), kRounding);
}

TEST(MeasuredAcceleration, UnhomeIsRefusedWhileEnabled) {
  TimedBench bench;
  EXPECT_EQ(bench.controller().request(StateCommand::kUnhome), Reason::kRefusedTransition);
  EXPECT_TRUE(bench.cycle().homed);
  bench.in_motion(0.15);
  EXPECT_EQ(bench.controller().request(StateCommand::kUnhome), Reason::kRefusedTransition);
  bench.cycle();
  EXPECT_TRUE(bench.out().homed);
  EXPECT_LE(bench.arm().worst_acceleration(), kRounding);
}

// --- a start ------------------------------------------------------------------------------------

TEST(MeasuredAcceleration, NothingResumesWhileTheLastCommandFades) {
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const int later : {0, 1, 3}) {
      TimedBench bench(law);
      bench.in_motion(0.08);
      bench.arm().forget();
      ASSERT_EQ(bench.cycle(0.06).reason, Reason::kOverrun);
      for (int i = 0; i < later; ++i) bench.cycle();
      ASSERT_GT(bench.out().qd_command.cwiseAbs().maxCoeff(), 0.2);
      EXPECT_EQ(bench.controller().request(StateCommand::kResume), Reason::kNotAtRest);
      for (int i = 0; i < 200; ++i) bench.cycle();
      EXPECT_EQ(bench.out().state, State::kPaused);
      ASSERT_EQ(bench.controller().request(StateCommand::kResume), Reason::kNone);
      for (int i = 0; i < 200; ++i) bench.cycle();
      EXPECT_LE(bench.arm().worst_acceleration(), kRounding) << later;
      EXPECT_EQ(bench.out().state, State::kEnabled);
    }
  }
}

/// A trocar point beside the shaft is approached gently: not as fast as the joints can.
TEST(MeasuredAcceleration, AStartOffThePivotConvergesSmoothly) {
  constexpr double kOff = 1.5e-3;  // [m]
  TimedBench bench(Law::kExact, {}, 0, 15, kOff);
  double fastest = 0;
  for (int i = 0; i < 1000; ++i) {
    const double before = bench.deviation();
    bench.cycle();
    fastest = std::max(fastest, (before - bench.deviation()) / kT);
    ASSERT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
  }
  std::printf("the shaft came to its trocar at %.1f mm/s at most\n", 1e3 * fastest);
  EXPECT_LT(fastest, 8 * kOff);  // [1/s] the pole; critically damped it is 8 / e
  EXPECT_LT(bench.deviation(), 1e-6);
}

}  // namespace
}  // namespace surg
