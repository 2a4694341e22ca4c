// Time and estimate of a stream's samples, and the jump gate and the wall that they meet.
#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "support/controller_bench.hpp"
#include "support/test_support.hpp"
#include "surg_core/limits/workspace.hpp"
#include "surg_core/motion/stream_input.hpp"

namespace surg {
namespace {

using test::Bench;
using test::Random;

// Samples of a sender: taken at a rate, delivered in bursts or with jitter, stamped by another
// clock.
struct Sender {
  double rate = 500, burst = 0, jitter = 0, drift = 0, offset = 1e4;
  bool stamped = true;
};

struct Sample {
  double taken, arrival;
  std::int64_t stamp_ns;
};

std::int64_t nanoseconds(double time) { return std::llround(1e9 * time); }

std::vector<Sample> send(const Sender& sender, double seconds, unsigned seed) {
  Random random(seed);
  std::vector<Sample> out;
  double last = 0;
  for (int k = 1; k < seconds * sender.rate; ++k) {
    const double taken = k / sender.rate;
    double arrival = taken + sender.jitter * random.uniform(0, 1);
    if (sender.burst > 0) arrival = std::ceil(taken / sender.burst - 1e-9) * sender.burst;
    last = std::max(last, arrival);
    const std::int64_t stamp_ns = nanoseconds(sender.offset + (1 + sender.drift) * taken);
    out.push_back({taken, last, sender.stamped ? stamp_ns : 0});
  }
  return out;
}

// Worst spread [s] of (time by the clock - time taken) once settled: its mean is the delay.
double spread(StreamClock& clock, const std::vector<Sample>& samples, double settled) {
  clock.reset({samples[0].arrival, samples[0].stamp_ns});
  double least = 1, greatest = -1;
  for (std::size_t k = 1; k < samples.size(); ++k) {
    clock.advance({samples[k].arrival, samples[k].stamp_ns});
    if (samples[k].taken < settled) continue;
    least = std::min(least, clock.time() - samples[k].taken);
    greatest = std::max(greatest, clock.time() - samples[k].taken);
  }
  return greatest - least;
}

TEST(StreamClock, StampsGiveTheSpacingWhateverTheTransport) {
  for (const double rate : {30.0, 100.0, 500.0, 2000.0}) {
    for (const double drift : {0.0, 2e-4, -2e-4}) {
      for (const Sender& sender : {Sender{rate, 0, 0, drift}, Sender{rate, 0.04, 0, drift},
                                   Sender{rate, 0, 0.03, drift}}) {
        StreamClock clock;
        EXPECT_LT(spread(clock, send(sender, 6, 1), 1.5), 0.006) << rate << " " << sender.jitter;
        EXPECT_TRUE(clock.stamped());
        EXPECT_NEAR(clock.period(), 1 / rate, 1e-3 / rate);
      }
    }
  }
}

TEST(StreamClock, WithoutStampsTheArrivalsGivePhaseAndPeriod) {
  for (const double rate : {30.0, 100.0, 500.0, 2000.0}) {
    for (const auto& [burst, jitter] :
         {std::pair(0.0, 0.0), std::pair(0.01, 0.0), std::pair(0.04, 0.0), std::pair(0.0, 0.03)}) {
      Sender sender{rate, burst, jitter};
      sender.stamped = false;
      StreamClock clock;
      EXPECT_LT(spread(clock, send(sender, 9, 2), 4), burst > 0.03 || jitter > 0 ? 0.02 : 0.005)
          << rate << " " << burst << " " << jitter;
      EXPECT_FALSE(clock.stamped());
    }
  }
}

TEST(StreamClock, StampsThatAreNoTimesAreNotUsed) {
  const auto stamped = [](const std::function<double(int)>& stamp) {
    StreamClock clock;
    clock.reset({0, nanoseconds(stamp(0))});
    int used = 0;
    for (int k = 1; k < 3000; ++k) {
      clock.advance({0.002 * k, nanoseconds(stamp(k))});
      if (k >= 1500) used += clock.stamped() ? 1 : 0;
    }
    EXPECT_NEAR(clock.time(), 0.002 * 2999, 0.01);
    return used;
  };
  EXPECT_EQ(stamped([](int) { return 0; }), 0);                           // none
  EXPECT_EQ(stamped([](int) { return 77; }), 0);                          // the same for ever
  EXPECT_EQ(stamped([](int k) { return 77 + 0.005 * (k * 2 / 5); }), 0);  // copied at 200 Hz
  EXPECT_EQ(stamped([](int k) { return 99 - 0.002 * k; }), 0);            // backwards
  EXPECT_EQ(stamped([](int k) { return 77 + 0.004 * k; }), 0);            // twice as fast
  EXPECT_EQ(stamped([](int k) { return 77 + 0.0021 * k; }), 0);           // 5 % too fast
  EXPECT_EQ(stamped([](int k) { return k == 1200 ? 77.0 : 100 + 0.002 * k; }),
            1299);  // again after a second
}

TEST(StreamClock, ADroppedSampleIsMissedWithAndWithoutStamps) {
  for (const bool has_stamps : {true, false}) {
    StreamClock clock;
    clock.reset({0, nanoseconds(has_stamps ? 9.0 : 0.0)});
    double t = 0, elapsed = 0;
    for (int k = 1; k < 120; ++k) {
      t += k == 100 ? 0.1 : 1.0 / 30;  // two samples are missing
      elapsed = clock.advance({t, nanoseconds(has_stamps ? 9 + t : 0)});
      if (k >= 100) {
        ASSERT_NEAR(elapsed, k == 100 ? 0.1 : 1.0 / 30, 2e-4) << k;
      }
    }
    EXPECT_NEAR(clock.time(), t, 1e-3);
  }
}

TEST(StreamEstimate, FindsAConstantVelocityAtAnySpacing) {
  for (const double spacing : {0.0005, 0.002, 0.005, 0.01, 1.0 / 30, 0.1}) {
    StreamEstimate estimate;
    estimate.reset({});
    int k = 0;
    for (; k < 4000; ++k) {
      const double x = 0.1 * (k + 1) * spacing;
      estimate.update({x, 2 * x, 0, -x}, spacing, spacing);
    }
    for (const double age : {0.01, -0.02}) {
      const auto now = estimate.predict(age);
      EXPECT_NEAR(now[0].v, 0.1, 1e-6) << spacing;
      EXPECT_NEAR(now[1].x, 0.2 * (k * spacing + age), 1e-6) << spacing;
      EXPECT_NEAR(now[3].x, -0.1 * (k * spacing + age), 1e-6);
      EXPECT_EQ(now[2].x, 0);
    }
  }
}

TEST(StreamEstimate, SamplesOfOneInstantAreNoVelocity) {
  StreamEstimate estimate;
  estimate.reset({});
  for (int k = 1; k < 200; ++k) estimate.update({}, 0.002, 0.002);
  estimate.update({0.001}, 0, 0.002);
  estimate.update({0.001}, 1e-6, 0.002);
  EXPECT_LT(std::abs(estimate.predict(0)[0].v), 0.3);
  EXPECT_LT(estimate.predict(0)[0].x, 0.001);
}

TEST(StreamInput, ASilentStreamEndsAtItsLastSample) {
  for (const double rate : {30.0, 500.0}) {
    StreamInput input;
    input.begin({0}, {}, {}, 0, 0);
    const int every = static_cast<int>(500 / rate);
    double x = 0;
    for (int k = 1; k <= 1000; ++k) {
      input.elapse(0.002);
      if (k % every == 0) input.add({x = 1e-4 * k}, 0, 0);
    }
    for (int k = 0; k < 31; ++k) input.elapse(0.002);
    EXPECT_EQ(input.target(0.002)[0].x, x);
    EXPECT_EQ(input.target(0.002)[0].v, 0);
  }
}

TEST(StreamInput, APlanIsPlayedToItsTimesAndNoFurther) {
  Random random(7);
  for (const int every : {25, 50, 80}) {  // ticks of 2 ms: 20, 10 and 6 Hz
    for (const double age : {0.0, 0.001}) {
      StreamInput input;
      double before = 0, last = 0;
      input.begin({0}, {}, {}, age, 0);
      for (int k = 1; k <= 40 * every; ++k) {
        input.elapse(0.002);
        const auto target = input.target(-age)[0];
        if (k > 3 * every) {
          const double share = static_cast<double>((k - 1) % every + 1) / every;
          ASSERT_NEAR(target.x, before + share * (last - before), 1e-9) << every << " " << k;
          ASSERT_EQ(input.target(0.002 * every)[0].x, last);
          ASSERT_EQ(input.target(0.002 * every + 0.004)[0].v, 0);
        }
        if (k % every != 0) continue;
        before = last;
        input.add({last = random.uniform(-0.01, 0.01)}, age, 0);
      }
    }
  }
}

TEST(StreamInput, ThePlanOfASteadySpeedIsThatSpeed) {
  StreamInput input;
  input.begin({0}, {}, {}, 0, 0);
  for (int k = 1; k <= 500; ++k) {
    input.elapse(0.002);
    if (k > 100) {
      ASSERT_NEAR(input.target(0)[0].x, 0.04 * (0.002 * k - 0.05), 1e-9) << k;
      ASSERT_NEAR(input.target(0)[0].v, 0.04, 1e-9) << k;
    }
    if (k % 25 == 0) input.add({0.04 * 0.002 * k}, 0, 0);
  }
}

// --- a delay that grows with what the hand asks for ----------------------------------------------

TEST(StreamLateness, GrowsWhileTheHandIsHardAndShrinksSlowly) {
  constexpr double kTick = 0.002, kPeriod = 0.002;
  StreamLateness lateness(0.05);
  EXPECT_EQ(lateness.delay(), 0.008);
  for (int k = 0; k < 500; ++k) lateness.step(0.7, kPeriod, kTick);
  EXPECT_EQ(lateness.delay(), 0.008);  // gentle
  double before = lateness.delay();
  int rising = 0;
  while (lateness.delay() < 0.05 && rising < 1000) {
    lateness.step(3, kPeriod, kTick);
    EXPECT_LE(lateness.delay() - before, 0.5 * kTick + 1e-12);  // slowed to half at most
    before = lateness.delay();
    ++rising;
  }
  EXPECT_NEAR(rising * kTick, 0.042 / 0.5, 2 * kTick);
  for (int k = 0; k < 500; ++k) lateness.step(0, kPeriod, kTick);
  EXPECT_NEAR(lateness.delay(), 0.05 - 0.02 * 500 * kTick, 1e-9);
  lateness.reset();
  EXPECT_EQ(lateness.delay(), 0.008);
}

TEST(StreamLateness, IsNeverMoreThanItsMost) {
  for (const double most : {0.0, 0.003, 0.008, 0.02, 0.1}) {
    StreamLateness lateness(most);
    for (int k = 0; k < 1000; ++k) lateness.step(5, 0.033, 0.002);
    EXPECT_NEAR(lateness.delay(), most, 1e-12);
    for (int k = 0; k < 5000; ++k) lateness.step(0, 0.033, 0.002);
    EXPECT_NEAR(lateness.delay(), std::min(most, 0.008), 1e-12);
  }
}

/// Strokes of 30 mm in 0.3 s, which take 3.5 times the acceleration of the arm, and rests.
double stroke(double t) {
  const double phase = std::fmod(t, 1.2), s = std::min(phase / 0.3, 1.0);
  const double up = 0.03 * s * s * s * (10 + s * (6 * s - 15));
  return std::fmod(t, 2.4) < 1.2 ? up : 0.03 - up;
}

TEST(StreamLateness, AWeakArmDoesNotOvershootAndFollowsAGentleHandAtOnce) {
  const DofLimits weak{0.25, 0.6, 100};
  const auto follow = [&](double delay, const std::function<double(double)>& hand) {
    const double T = 0.002;
    StreamInput input(delay, 0);
    StreamFilter filter(weak);
    filter.reset({hand(0), 0, 0});
    input.begin({hand(0)}, {Kinematic{hand(0), 0, 0}}, {weak.acceleration}, 0, 0);
    double beyond = 0, late = 0;
    for (int k = 1; k < 6000; ++k) {
      input.elapse(T);
      input.add({hand(k * T)}, 0, 0);
      const Kinematic soon = input.estimate(T)[0];
      filter.step(input.target(T)[0], T, 0, input.delayed() ? &soon : nullptr);
      beyond = std::max({beyond, filter.state().x - 0.03, -filter.state().x});
      late = std::max(late, input.delay());
    }
    return std::pair(1e3 * beyond, 1e3 * late);
  };
  const auto fixed = follow(0, stroke), adaptive = follow(0.05, stroke);
  std::printf("[  figures ] overshoot %.2f mm at once, %.2f mm up to %.0f ms later\n", fixed.first,
              adaptive.first, adaptive.second);
  EXPECT_LT(fixed.first, 0.5);
  EXPECT_LT(adaptive.first, 0.5);  // 9.8 mm if it does not look ahead
  EXPECT_NEAR(adaptive.second, 50, 1e-9);
  const auto gentle = [](double t) { return 0.015 + 0.01 * std::sin(3 * t); };
  EXPECT_NEAR(follow(0.05, gentle).second, 8, 1e-9);
}

/// Gain and lag [s] for a sine through the estimate alone.
std::pair<double, double> gain_and_lag(double hertz, double rate, double tremor) {
  const double T = 0.002, w = 2 * M_PI * hertz, begin = 4, end = 14;
  StreamInput input(0, tremor);
  double sine = 0, cosine = 0;
  long sent = 0;
  for (long k = 0; k * T < end; ++k) {
    for (; sent / rate <= k * T + 1e-9; ++sent) {
      const double taken = sent / rate, x = std::sin(w * taken);
      const std::int64_t stamp = 1 + std::llround(1e9 * taken);
      if (sent == 0) {
        input.begin({x, 0, 0, 0}, {}, {}, 0, stamp);
      } else {
        input.add({x, 0, 0, 0}, k * T - taken, stamp);
      }
    }
    input.elapse(T);
    const double t = (k + 1) * T;
    if (t < begin) continue;
    sine += input.target(0)[0].x * std::sin(w * t);
    cosine += input.target(0)[0].x * std::cos(w * t);
  }
  sine *= 2 * T / (end - begin), cosine *= 2 * T / (end - begin);
  return {std::hypot(sine, cosine), -std::atan2(cosine, sine) / w};
}

TEST(TremorEstimate, TakesTheTremorAndDelaysTheRestByWhatIsStatedAtAnyRate) {
  for (const double rate : {25.0, 30.0, 60.0, 100.0, 500.0}) {
    for (const double hertz : {8.0, 9.0, 10.0, 11.0, 12.0}) {
      EXPECT_LT(gain_and_lag(hertz, rate, 10).first, 0.4) << hertz << " of " << rate;
    }
    for (const double hertz : {0.5, 1.0, 2.0, 3.0}) {
      const auto [gain, lag] = gain_and_lag(hertz, rate, 10);
      EXPECT_NEAR(gain, 1, 0.05) << hertz << " of " << rate;
      const double within = hertz > 1 ? 0.004 : 0.001;
      EXPECT_NEAR(lag, TremorEstimate::late(1 / rate), within) << hertz << " of " << rate;
    }
  }
  EXPECT_NEAR(TremorEstimate::late(0.002), 0.0176, 5e-4);
  EXPECT_NEAR(TremorEstimate::late(1 / 30.0), 0.043, 5e-4);
  EXPECT_GT(gain_and_lag(9, 30, 0).first, 0.9);  // without it
  EXPECT_FALSE(TremorEstimate().works());
}

TEST(StreamInput, AtEveryRateASineKeepsItsSize) {
  for (const double rate : {25.0, 30.0, 40.0, 60.0, 100.0, 500.0}) {
    for (const double hertz : {0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.5, 5.0, 6.5, 7.0}) {
      if (hertz > 5 && rate < 60) continue;
      const auto [gain, lag] = gain_and_lag(hertz, rate, 0);
      EXPECT_NEAR(gain, 1, 0.05) << hertz << " of " << rate;
      EXPECT_NEAR(lag, HandEstimate::late(1 / rate), 0.003) << hertz << " of " << rate;
    }
    for (double hertz = 6; hertz < 12.1; hertz += 0.5) {
      EXPECT_LT(gain_and_lag(hertz, rate, 0).first, 2) << hertz << " of " << rate;
    }
  }
}

TEST(StepGate, ManySmallStepsInOneCycleAreOneLargeStep) {
  Bench bench;
  const Vector3 from = bench.tip_in_R();
  for (int k = 1; k <= 30; ++k)
    bench.send(bench.pose(Motion::kServoCp, from + Vector3(0.0019 * k, 0, 0)));
  bench.tick();
  EXPECT_EQ(bench.out().accepted, 1u);
  for (int k = 1; k < 30; ++k) {
    EXPECT_EQ(bench.out().verdicts[k].reason, Reason::kStepTooLarge) << k;
  }
}

TEST(StepGate, ABurstMayMoveWhatTheTimeSinceTheLastOneAllows) {
  Bench bench;
  const Vector3 from = bench.tip_in_R();
  // 0.2 m/s for 40 ms, every 40 ms, 80 samples: those beyond 64 come one cycle later.
  Vector3 p = from;
  std::vector<Vector3> waiting;
  for (int tick = 0; tick < 200; ++tick) {
    if (tick % 20 == 0) {
      for (int k = 0; k < 80; ++k) {
        const double t = tick * 0.002 + 0.0005 * k, grow = std::min(t, 0.1) / 0.1;
        p = from + Vector3(0.01 * grow * std::sin(20 * t), 0, 0);
        waiting.push_back(p);
      }
    }
    const std::size_t n = std::min<std::size_t>(waiting.size(), kMaxCommands);
    for (std::size_t k = 0; k < n; ++k) bench.send(bench.pose(Motion::kServoCp, waiting[k]));
    waiting.erase(waiting.begin(), waiting.begin() + static_cast<long>(n));
    bench.tick();
    EXPECT_EQ(bench.out().refused, 0u) << tick;
  }
}

// A hand leaves the workspace sideways by up to 'beyond', moves along outside and comes back.
Vector3 excursion(const Limits& limits, double beyond, double t) {
  const double angle = limits.cone * 0.9 * std::min(t / 3, 1.0);
  const double out = t < 3 ? 0 : std::sin((t - 3) * M_PI / 4);  // back inside after 4 s
  const double tilt = angle + limits.cone * 0.1 * std::max(out, -0.5) * (1 + beyond * 50);
  const double turn = t < 3 ? 0 : 0.2 * std::sin(t - 3);
  return 0.12 *
         Vector3(std::sin(tilt) * std::cos(turn), std::sin(tilt) * std::sin(turn), std::cos(tilt));
}

TEST(Wall, AStreamOutsideIsRefusedUnlessItsSenderSlides) {
  for (const bool slide : {false, true}) {
    Bench bench;
    const Limits limits = bench.robot().limits;
    long refused = 0, reported = 0, outside = 0;
    double farthest = -1, worst_end = 0;
    for (int k = 0; k < 4200; ++k) {
      const Vector3 hand = excursion(limits, 0.01, 0.002 * k);
      MotionCommand command = bench.pose(Motion::kServoCp, hand);
      command.slide = slide;
      bench.ask(command);
      const bool is_outside = !inside_workspace(limits, hand);
      outside += is_outside;
      refused += bench.out().verdicts[0].reason != Reason::kNone;
      reported += bench.out().reason == Reason::kOutsideWorkspace;
      farthest = std::max(farthest, outside_workspace(limits, bench.tip_in_R()));
      if (k > 4000) worst_end = std::max(worst_end, (bench.tip_in_R() - hand).norm());
    }
    ASSERT_GT(outside, 300);
    EXPECT_LT(farthest, 1e-4);
    if (!slide) {
      EXPECT_GE(refused, outside);
      EXPECT_EQ(reported, 0);
    } else {
      EXPECT_EQ(refused, 0);
      EXPECT_NEAR(static_cast<double>(reported), static_cast<double>(outside), 2);
      EXPECT_LT(worst_end, 0.002);
    }
  }
}

TEST(Wall, TheNearestPointInsideIsInsideAndNearest) {
  const Limits limits = test::robot_behind(test::good_robot()).limits;
  Random random(4);
  const int count = test::family(2000, 20000);
  for (int k = 0; k < count; ++k) {
    const Vector3 p(random.uniform(-0.4, 0.4), random.uniform(-0.4, 0.4),
                    random.uniform(-0.3, 0.5));
    const Vector3 inside = nearest_inside(limits, p, 1e-3);
    ASSERT_LE(outside_workspace(limits, inside), -0.3e-3) << p.transpose();
    // No point around it is nearer and as far inside.
    for (int i = 0; i < 20; ++i) {
      const Vector3 other =
          inside + 1e-3 * Vector3(random.normal(), random.normal(), random.normal());
      if (outside_workspace(limits, other) > -1.001e-3) continue;
      ASSERT_GE((other - p).norm(), (inside - p).norm() - 1e-5) << p.transpose();
    }
  }
  test::report("points", count);
}

}  // namespace
}  // namespace surg
