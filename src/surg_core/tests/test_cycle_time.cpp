// Cycles that come late: the arm stays on its pivot and its watchdogs keep real time, or it pauses
// and says so (F27). The oracle is the arm's own motion, in its own time.
#include <cstdio>
#include <functional>

#include "support/test_support.hpp"
#include "support/timed_bench.hpp"

namespace surg {
namespace {

using namespace test;

constexpr double kRounding = 1 + 1e-6;
constexpr double kAtRest = 5e-3;             // [rad/s]
constexpr double kShippedAcceleration = 40;  // [rad/s^2] of the UR5e
constexpr double kKept = 3e-4;               // [m] of the pivot, whatever the clock does

using Periods = std::function<double(Random&)>;  // [s]

Periods steady(double period) {
  return [period](Random&) { return period; };
}
Periods drawn(double shortest, double longest) {
  return [=](Random& random) {
    const int from = std::lround(shortest / TimedArm::kStep);
    return TimedArm::kStep * random.integer(from, std::lround(longest / TimedArm::kStep));
  };
}
Periods one_late_in_a_hundred(double late) {
  return [=](Random& random) { return random.integer(1, 100) == 1 ? late : kT; };
}

struct Case {
  const char* name;
  Periods periods;
  bool may_pause;
  double kept = 3e-4;  // [m] of the pivot
};

const Case kCases[] = {{"on time", steady(kT), false},
                       {"1 % of 20 ms", one_late_in_a_hundred(0.020), false},
                       {"1 % of 40 ms", one_late_in_a_hundred(0.040), true, 5e-4},
                       {"drawn, 2 to 4 ms", drawn(0.002, 0.004), false},
                       {"drawn, 2 to 10 ms", drawn(0.002, 0.010), true},
                       {"steady, 3 ms", steady(0.003), false},
                       {"steady, 4 ms", steady(0.004), false},
                       {"steady, 6 ms", steady(0.006), true},
                       {"steady, 8 ms", steady(0.008), true},
                       {"steady, 10 ms", steady(0.010), true}};

struct Arm {
  const char* name;
  Plant plant;
  double link_lag;
};

const Arm kArms[] = {{"ideal", {}, 0.0}, {"lagging", {0.004, 0.008}, 0.012}};

Vector3 hand(double t) {
  const double ramp = std::min(t, 1.0);
  return Vector3(0, 0, 0.12) + ramp * Vector3(0.03 * std::sin(3.1 * t), 0.03 * std::sin(2.3 * t),
                                              0.02 * std::sin(1.3 * t));
}

struct Figures {
  double pivot = 0, acceleration = 0;
  State state = State::kEnabled;
  Reason reason = Reason::kNone;
  double enabled = 0;  // [s] until it left ENABLED, or the whole run
};

/// How a hand at some 0.1 m/s sends its poses.
struct Sender {
  const char* name;
  double rate;  ///< [1/s] of its own; 0: it answers each cycle
  bool stamped;
};

const Sender kSenders[] = {{"answers", 0, true},
                           {"500 Hz", 500, true},
                           {"500 Hz, no stamps", 500, false},
                           {"60 Hz, no stamps", 60, false}};

Figures follow_a_hand(Law law, const Arm& arm, const Periods& periods, const Sender& sender,
                      std::uint64_t seed) {
  Random random(seed);
  TimedBench bench(law, arm.plant, arm.link_lag);
  Figures figures;
  const double begin = bench.time();
  double taken = begin;
  while (bench.time() - begin < test::family(10, 60)) {
    const double period = periods(random), now = bench.time() + period;
    const double spacing = sender.rate > 0 ? 1 / sender.rate : period;
    taken = std::max(taken, now - (kMaxCommands - 1) * spacing);  // older ones are dropped
    for (; taken + spacing < now + 1e-9; taken += spacing) {
      MotionCommand& pose = bench.servo_cp(hand(taken + spacing - begin));
      pose.age = std::max(now - taken - spacing, 0.0);
      if (sender.stamped) pose.stamp_ns = 1 + std::llround(1e9 * (taken + spacing));
    }
    const Outputs& out = bench.cycle(period);
    if (out.state == State::kEnabled) {
      figures.enabled = bench.time() - begin;
    } else if (figures.reason == Reason::kNone) {
      figures.state = out.state;
      figures.reason = out.reason;
    }
  }
  figures.pivot = bench.worst_pivot();
  figures.acceleration = bench.arm().worst_acceleration();
  return figures;
}

TEST(CycleTime, LateCyclesLeaveThePivotAloneOrPauseTheArm) {
  int runs = 0;
  for (const Arm& arm : kArms) {
    for (const Law law : {Law::kExact, Law::kVelocity}) {
      for (const Case& c : kCases) {
        for (const Sender& sender : kSenders) {
          const Figures f = follow_a_hand(law, arm, c.periods, sender, ++runs);
          std::printf(
              "%-8s law %d, %-18s %-18s pivot %.3f mm, acceleration %.2f, ENABLED %.1f s %s\n",
              arm.name, static_cast<int>(law), c.name, sender.name, 1e3 * f.pivot, f.acceleration,
              f.enabled, name(f.reason));
          EXPECT_LE(f.pivot, c.kept) << c.name << ", " << sender.name;
          EXPECT_LE(f.acceleration, kRounding) << c.name;
          if (!c.may_pause) {
            EXPECT_EQ(f.state, State::kEnabled) << c.name;
          }
          if (f.state != State::kEnabled) {
            EXPECT_EQ(f.state, State::kPaused) << c.name;
            EXPECT_EQ(f.reason, Reason::kOverrun) << c.name;
          }
        }
      }
    }
  }
  test::report("runs", runs);
}

/// Largest distance [m] of the arm's tip from where the hand was in the last 40 ms; the hand sends
/// one pose in each cycle, so none in a late one.
double off_the_hand(Law law, const Arm& arm, const Periods& periods, bool stamped) {
  Random random(5);
  TimedBench bench(law, arm.plant, arm.link_lag);
  const double begin = bench.time();
  double worst = 0;
  while (bench.time() - begin < test::family(10, 60)) {
    const double period = periods(random), now = bench.time() + period;
    MotionCommand& pose = bench.servo_cp(hand(now - begin));
    if (stamped) pose.stamp_ns = 1 + std::llround(1e9 * now);
    const Outputs& out = bench.cycle(period);
    EXPECT_EQ(out.state, State::kEnabled) << name(out.reason);
    const Vector3 tip = bench.controller().X_BR().inverse() * out.p_BTip;
    double nearest = 1;
    for (double late = 0; late <= 0.0801; late += 0.002) {
      nearest = std::min(nearest, (tip - hand(std::max(now - late - begin, 0.0))).norm());
    }
    if (now - begin > 2) worst = std::max(worst, nearest);
  }
  return worst;
}

TEST(CycleTime, APoseFromEachCycleIsFollowedThroughLateOnes) {
  const double gaps = 1e-4 * test::family(10, 25);  // [m] long runs have several in a row
  const std::pair<Case, double> cases[] = {{kCases[1], gaps}, {kCases[3], 5e-4}};
  int runs = 0;
  for (const Arm& arm : kArms) {
    for (const Law law : {Law::kExact, Law::kVelocity}) {
      for (const auto& [c, most] : cases) {
        for (const bool stamped : {true, false}) {
          const double off = off_the_hand(law, arm, c.periods, stamped);
          std::printf("%-8s law %d, %-18s %s: %.2f mm off the hand's path\n", arm.name,
                      static_cast<int>(law), c.name, stamped ? "stamped" : "not stamped",
                      1e3 * off);
          EXPECT_LE(off, most) << c.name;
          ++runs;
        }
      }
    }
  }
  test::report("runs", runs);
}

// F03: the stream's deadline is one of real time.
TEST(CycleTime, ASilentStreamStopsInRealTime) {
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const double period : {0.002, 0.004, 0.006, 0.008, 0.010}) {
      TimedBench bench(law, {}, 0, kShippedAcceleration);
      double sent = 0;
      for (int i = 0; i < 50; ++i) {
        bench.servo_cv(Vector3(0.05, 0, 0));
        bench.cycle(period);
        sent = bench.time();
      }
      ASSERT_EQ(bench.out().state, State::kEnabled);
      double rest = 0;
      while (bench.time() - sent < 2 && rest == 0) {
        bench.cycle(period);
        if (bench.arm().qd().cwiseAbs().maxCoeff() < kAtRest) rest = bench.time() - sent;
      }
      std::printf("law %d, cycles of %.0f ms: at rest %.3f s after the last command\n",
                  static_cast<int>(law), 1e3 * period, rest);
      EXPECT_GT(rest, 0.1);
      // The deadline, a cycle to notice it, and the ramp, which takes one step in each cycle.
      const double ramp = 0.05 / bench.robot().limits.stop_deceleration * period / kT;
      EXPECT_LE(rest, 0.1 + 2 * period + ramp + 0.06);
    }
  }
}

// --- the link's dead-man ------------------------------------------------------------------------

TEST(CycleTime, AControllerThatWakesUpTakesTheArmAsItFindsIt) {
  for (const Arm& arm : kArms) {
    for (const Law law : {Law::kExact, Law::kVelocity}) {
      for (const double dead_man : {0.02, 0.1}) {
        for (const double frozen : {0.015, 0.03, 0.05, 0.08, 0.15, 0.3, 2.0}) {
          for (const double into : {0.02, 0.3}) {  // [s] since the motion began
            Plant plant = arm.plant;
            plant.dead_man = dead_man;
            TimedBench bench(law, plant, arm.link_lag);
            bench.in_motion(0.1, into);
            bench.arm().forget();
            bench.servo_cv(Vector3(0.1, 0, 0));
            bench.cycle(frozen);
            const bool stopped = bench.arm().stopped();
            // The end of the link's own ramp and the first command may share a period.
            const double most = stopped ? 1.5 * kRounding : kRounding;
            for (int i = 0; i < 200; ++i) {
              bench.servo_cv(Vector3(0.1, 0, 0));
              bench.cycle();
            }
            EXPECT_LE(bench.arm().worst_acceleration(), most)
                << arm.name << " law " << static_cast<int>(law) << ", dead-man " << dead_man
                << " s, frozen " << frozen << " s, " << into << " s into the motion";
            if (frozen < 0.02) {
              EXPECT_LE(bench.worst_pivot(), kKept) << frozen;
            }
            if (frozen > dead_man + 0.03 && into > 0.1) {
              EXPECT_EQ(bench.out().reason, Reason::kOverrun) << frozen;
            }
          }
        }
      }
    }
  }
}

/// A machine that serves the controller every 12 to 38 ms: each command comes before the link stops
/// the arm by itself, and a stop in steps of one period would take many times its way.
TEST(CycleTime, AStarvedControllerLeavesTheStopToTheLink) {
  int runs = 0;
  double worst = 0, longest = 0;
  for (const Arm& arm : kArms) {
    for (const Law law : {Law::kExact, Law::kVelocity}) {
      for (int seed = 0; seed < test::family(5, 50); ++seed) {
        Random random(1000 + seed);
        Plant plant = arm.plant;
        plant.dead_man = 0.04;
        TimedBench bench(law, plant, arm.link_lag);
        bench.in_motion(0.1, random.uniform(0.3, 1.0));
        bench.forget();
        const double begin = bench.time();
        double rest = 0;
        const auto watch = [&](double period) {
          bench.servo_cv(Vector3(0.1, 0, 0));
          bench.cycle(period);
          if (bench.arm().qd().cwiseAbs().maxCoeff() > kAtRest) rest = bench.time() - begin;
        };
        while (bench.time() - begin < 0.6) watch(TimedArm::kStep * random.integer(12, 38));
        for (int i = 0; i < 200; ++i) watch(kT);
        worst = std::max(worst, bench.worst_pivot());
        longest = std::max(longest, rest);
        EXPECT_EQ(bench.out().state, State::kPaused);
        EXPECT_EQ(bench.out().reason, Reason::kOverrun);
        EXPECT_LE(bench.arm().worst_acceleration(), 1.5 * kRounding);
        ++runs;
      }
    }
  }
  std::printf("pivot %.3f mm, at rest %.3f s after the starvation began\n", 1e3 * worst, longest);
  // Up to 0.09 s straight on in joint space, and the ramp. Rare commands alone take 6 mm and 1 s.
  EXPECT_LE(worst, 4e-3);
  EXPECT_LE(longest, 0.2);
  test::report("runs", runs);
}

TEST(CycleTime, NothingStartsWhileTheArmBrakesBlindly) {
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    TimedBench bench(law);
    bench.in_motion(0.1, 0.3);
    bench.cycle(0.08);
    ASSERT_EQ(bench.out().reason, Reason::kOverrun);
    int refused = 0;
    const auto resume = [&] { return bench.controller().request(StateCommand::kResume); };
    for (; resume() == Reason::kNotAtRest && refused < 500; ++refused) {
      EXPECT_EQ(bench.controller().request(StateCommand::kHome), Reason::kNotAtRest);
      bench.cycle();
    }
    EXPECT_GT(refused, 3);
    EXPECT_LE(bench.arm().qd().cwiseAbs().maxCoeff(), 2 * 15 * kT);  // and one cycle of braking
    const double begin = bench.deviation();
    bench.forget();
    for (int i = 0; i < 100; ++i) bench.cycle();
    EXPECT_EQ(bench.out().state, State::kEnabled);
    EXPECT_LE(bench.worst_pivot(), begin + 5e-5);
  }
}

TEST(CycleTime, CommandsThatAreLostOnTheirWayDoNotComeBackAtFullSpeed) {
  for (const Arm& arm : kArms) {
    for (const Law law : {Law::kExact, Law::kVelocity}) {
      for (const double dead_man : {0.02, 0.1}) {
        Plant plant = arm.plant;
        plant.dead_man = dead_man;
        TimedBench bench(law, plant, arm.link_lag);
        bench.in_motion(0.1, 0.3);
        bench.arm().forget();
        double worst = 0;
        for (int i = 0; i < 400; ++i) {
          bench.servo_cv(Vector3(0.1, 0, 0));
          bench.cycle(kT, i < 100);
          worst = std::max(worst, bench.arm().worst_acceleration());
        }
        std::printf("%s, law %d, dead-man %.2f s: %.2f of the limit, %s\n", arm.name,
                    static_cast<int>(law), dead_man, worst, name(bench.out().reason));
        EXPECT_LE(worst, kRounding) << dead_man;
        EXPECT_EQ(bench.out().state, State::kPaused);
      }
    }
  }
}

}  // namespace
}  // namespace surg
