#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <stdexcept>

#include "support/quintic_oracle.hpp"
#include "support/test_support.hpp"
#include "surg_core/motion/profiler.hpp"

namespace surg {
namespace {

using test::Random;
using Dofs = std::array<Kinematic, Profiler::kDof>;
using Targets = std::array<double, Profiler::kDof>;

const DofLimits kTip{0.25, 2.0, 40.0}, kRoll{3.0, 40.0, 800.0};
const std::array<DofLimits, 4> kLimits{kTip, kTip, kTip, kRoll};

// A state from which the limits can be kept at all: full jerk brings a to zero before |v| reaches
// V.
Kinematic keepable_state(Random& random, const DofLimits& limits) {
  Kinematic s;
  s.x = random.uniform(-0.1, 0.1);
  s.a = random.integer(0, 3) == 0 ? 0 : random.uniform(-limits.acceleration, limits.acceleration);
  const double spent = 0.5 * s.a * s.a / limits.jerk;
  const double high = limits.velocity - (s.a > 0 ? spent : 0);
  const double low = -limits.velocity + (s.a < 0 ? spent : 0);
  s.v = random.integer(0, 3) == 0 ? (low > 0 || high < 0 ? high : 0) : random.uniform(low, high);
  return s;
}

/// The largest excess of a family over its limits, and how its members were planned.
struct Tally {
  long cases = 0, violations[3] = {0, 0, 0};        // velocity, acceleration, jerk
  double velocity = 0, acceleration = 0, jerk = 0;  // against what is allowed
  long quintic = 0, eased = 0, stopped = 0;

  void note(double v, double a, double j) {
    velocity = std::max(velocity, v);
    acceleration = std::max(acceleration, a);
    jerk = std::max(jerk, j);
    const double rounding = 1 + 1e-9;
    violations[0] += v > rounding;
    violations[1] += a > rounding;
    violations[2] += j > rounding;
  }
  long sum() const { return violations[0] + violations[1] + violations[2]; }
};

double eased_velocity(const Kinematic& s, const DofLimits& limits) {
  return s.v + 0.5 * s.a * std::abs(s.a) / limits.jerk;
}

/// Looks at a plan from every side: each quintic through the oracle, the braking by 100 samples,
/// and the whole as it is played by 40.
void examine(const Profiler& planned, const Dofs& from, const Targets& target, Tally& tally) {
  const double brake = planned.brake_duration(), total = planned.duration();
  Profiler player = planned;
  player.advance(brake);
  const Dofs start = player.state();
  for (int i = 0; i < Profiler::kDof; ++i) {
    const DofLimits& limits = kLimits[i];
    // What the start itself makes unavoidable is allowed.
    const double V =
        std::max({limits.velocity, std::abs(from[i].v), std::abs(eased_velocity(from[i], limits))});
    const double A = std::max(limits.acceleration, std::abs(from[i].a));
    const test::QuinticOracle oracle(brake > 0 ? start[i] : from[i], target[i], total - brake);
    const test::Extremes q = oracle.extremes();
    Kinematic last = from[i];
    double v = q.velocity, a = q.acceleration, j = q.jerk;
    for (int k = 1; k <= 100 && brake > 0; ++k) {
      Profiler sampler = planned;
      sampler.advance(k < 100 ? brake * k / 100 : brake * (1 - 1e-12));
      const Kinematic now = sampler.state()[i];
      v = std::max(v, std::abs(now.v));
      a = std::max(a, std::abs(now.a));
      j = std::max(j, std::abs(now.a - last.a) / (brake / 100) * (1 - 1e-9));
      last = now;
    }
    if (brake > 0) {  // the quintic goes on where the braking ends
      ASSERT_NEAR(start[i].x, last.x, 1e-9);
      ASSERT_NEAR(start[i].v, last.v, 1e-9);
      ASSERT_NEAR(start[i].a, last.a, 1e-9);
    }
    tally.note(v / V, a / A, j / limits.jerk);
    Profiler at = planned;
    at.advance(brake);
    for (int k = 1; k <= 40; ++k) {
      at.advance((total - brake) / 40);
      const double t = (total - brake) * k / 40;
      ASSERT_NEAR(at.state()[i].x, oracle.x(t), 1e-9);
      ASSERT_NEAR(at.state()[i].v, oracle.v(t), 1e-9);
      ASSERT_NEAR(at.state()[i].a, oracle.a(t), 1e-8);
    }
    at.advance(total);
    ASSERT_EQ(at.state()[i].x, target[i]);
    ASSERT_EQ(at.state()[i].v, 0);
    ASSERT_EQ(at.state()[i].a, 0);
  }
  ++tally.cases;
  (planned.brake_duration() == 0                                              ? tally.quintic
   : start[0].v == 0 && start[1].v == 0 && start[2].v == 0 && start[3].v == 0 ? tally.stopped
                                                                              : tally.eased)++;
}

void print(const char* family, const Tally& t) {
  std::printf(
      "%s: %ld cases; beyond v %ld, a %ld, jerk %ld; largest share of v "
      "%.9f, a %.9f, jerk %.9f; %ld quintic, %ld eased first, %ld stopped first\n",
      family, t.cases, t.violations[0], t.violations[1], t.violations[2], t.velocity,
      t.acceleration, t.jerk, t.quintic, t.eased, t.stopped);
}

void random_move(Random& random, Dofs& from, Targets& target) {
  for (int i = 0; i < 4; ++i) {
    from[i] = keepable_state(random, kLimits[i]);
    target[i] = from[i].x + random.uniform(-1, 1) * random.magnitude(1e-4, 0.3);
  }
}

TEST(Profiler, KeepsItsLimitsFromAnyStateThatCan) {
  Random random(1);
  const int count = test::family(1500, 100000);
  Profiler profiler(kLimits, 0.5);
  Tally tally;
  for (int k = 0; k < count; ++k) {
    Dofs from;
    Targets target;
    random_move(random, from, target);
    profiler.reset(from);
    ASSERT_TRUE(profiler.plan(target)) << "family member " << k;
    ASSERT_NO_FATAL_FAILURE(examine(profiler, from, target, tally)) << "member " << k;
    ASSERT_LT(profiler.duration(), 12);
  }
  EXPECT_EQ(tally.sum(), 0);
  test::report("random states", count);
  print("in motion", tally);
}

TEST(Profiler, ReturnsFromBeyondItsLimitsAsDirectlyAsItMay) {
  Random random(7);
  const int count = test::family(500, 40000);
  Profiler profiler(kLimits, 0.5);
  Tally tally;
  for (int k = 0; k < count; ++k) {
    Dofs from;
    Targets target;
    random_move(random, from, target);
    const int beyond = random.integer(0, 3);
    from[beyond].a = kLimits[beyond].acceleration * random.uniform(-3, 3);
    if (random.integer(0, 2) == 0)
      from[beyond].v = kLimits[beyond].velocity * random.uniform(-2, 2);
    profiler.reset(from);
    profiler.plan(target);
    ASSERT_NO_FATAL_FAILURE(examine(profiler, from, target, tally)) << "member " << k;
  }
  EXPECT_EQ(tally.sum(), 0);
  test::report("random states beyond a limit", count);
  print("beyond an acceleration or velocity limit", tally);
}

TEST(Profiler, StateIsContinuousAndConsistent) {
  Random random(2);
  const int count = test::family(200, 5000);
  Profiler profiler(kLimits, 0.5);
  for (int k = 0; k < count; ++k) {
    Dofs from;
    Targets target;
    for (int i = 0; i < 4; ++i) {
      from[i] = keepable_state(random, kLimits[i]);
      target[i] = from[i].x + random.uniform(-0.2, 0.2);
    }
    profiler.reset(from);
    profiler.plan(target);
    Dofs last = profiler.state();
    const double dt = 0.001;
    while (!profiler.done()) {
      profiler.advance(dt);
      for (int i = 0; i < 4; ++i) {
        const Kinematic& now = profiler.state()[i];
        // Within one step the parabola of the last state is right but for the jerk.
        ASSERT_NEAR(now.x, last[i].x + dt * last[i].v, kLimits[i].acceleration * dt * dt);
        ASSERT_NEAR(now.v, last[i].v + dt * last[i].a, kLimits[i].jerk * dt * dt);
        last[i] = now;
      }
    }
  }
  test::report("random profiles", count);
}

TEST(Profiler, ChangesOfMindKeepTheLimits) {
  Random random(3);
  const int count = test::family(300, 40000);
  Profiler profiler(kLimits, 0.5);
  profiler.reset(Dofs{});
  Tally tally;
  for (int k = 0; k < count; ++k) {
    Targets target;
    for (double& x : target) x = random.uniform(-0.15, 0.15);
    const Dofs from = profiler.state();
    // A plan is always followed by one: the state on the way is never a trap.
    ASSERT_TRUE(profiler.plan(target)) << "family member " << k;
    ASSERT_NO_FATAL_FAILURE(examine(profiler, from, target, tally)) << "member " << k;
    const int steps = random.integer(1, 400);
    for (int n = 0; n < steps; ++n) profiler.advance(0.002);
  }
  EXPECT_EQ(tally.sum(), 0);
  test::report("changes of mind", count);
  print("changes of mind on the way", tally);
}

TEST(Profiler, RestToRestTakesTheLeastDuration) {
  Random random(4);
  const int count = test::family(2000, 50000);
  Profiler profiler(kLimits, 0.5);
  double worst = 0;
  for (int k = 0; k < count; ++k) {
    Targets target;
    double expected = 0.5;
    for (int i = 0; i < 4; ++i) {
      target[i] = random.uniform(-1, 1) * random.magnitude(1e-4, 0.5);
      const double D = std::abs(target[i]);
      expected = std::max({expected, 15 * D / (8 * kLimits[i].velocity),
                           std::sqrt(10 * D / (std::sqrt(3.0) * kLimits[i].acceleration)),
                           std::cbrt(60 * D / kLimits[i].jerk)});
    }
    profiler.reset(Dofs{});
    profiler.plan(target);
    worst = std::max(worst, std::abs(profiler.duration() / expected - 1));
    // It is the least: by the oracle, one part in a thousand less breaks a limit.
    if (expected == 0.5) continue;
    double share = 0;
    for (int i = 0; i < 4; ++i) {
      const test::Extremes e =
          test::QuinticOracle({0, 0, 0}, target[i], 0.999 * expected).extremes();
      share = std::max({share, e.velocity / kLimits[i].velocity,
                        e.acceleration / kLimits[i].acceleration, e.jerk / kLimits[i].jerk});
    }
    ASSERT_GT(share, 1.0009);
  }
  ASSERT_LT(worst, 1e-12);
  test::report("random distances", count);
  std::printf(
      "Rest to rest, %d random distances: the duration differs from "
      "max(0.5 s, 15 D / 8 v, √(10 D / √3 a), ∛(60 D / j)) by at most %.0e "
      "of it.\n",
      count, worst);
}

/// The duration that a ten times finer scan finds, judged by the oracle.
double fine_scan(const Dofs& from, const Targets& target, double d, double end) {
  for (; d < end; d *= 1.004) {
    bool good = true;
    for (int i = 0; i < 4 && good; ++i) {
      const test::Extremes e = test::QuinticOracle(from[i], target[i], d).extremes();
      good = e.velocity <= kLimits[i].velocity && e.acceleration <= kLimits[i].acceleration &&
             e.jerk <= kLimits[i].jerk;
    }
    if (good) return d;
  }
  return end;
}

TEST(Profiler, InMotionTheScanHardlyMissesAShorterDuration) {
  Random random(8);
  const int count = test::family(200, 5000);
  Profiler profiler(kLimits, 0.5);
  int shorter = 0, looked_at = 0;
  double most = 0;
  for (int k = 0; k < count; ++k) {
    Dofs from;
    Targets target;
    random_move(random, from, target);
    profiler.reset(from);
    profiler.plan(target);
    if (profiler.brake_duration() > 0) continue;
    const double d = profiler.duration();
    const double saved = d - fine_scan(from, target, 0.5, d);
    shorter += saved > 0.004 * d;
    most = std::max(most, saved / d);
    ++looked_at;
  }
  EXPECT_LE(shorter, 0.02 * looked_at);
  test::report("random states scanned ten times finer", looked_at);
  std::printf(
      "In motion, %d random states: a scan ten times finer finds a duration "
      "shorter by more than 0.4 %% in %d of them, by %.0f %% at most.\n",
      looked_at, shorter, 100 * most);
}

TEST(Profiler, BaseDurationIsThePapers) {
  Profiler profiler(kLimits, 0.5);
  profiler.reset(Dofs{});
  profiler.plan({0.001, 0, 0, 0});
  EXPECT_EQ(profiler.duration(), 0.5);
  EXPECT_FALSE(profiler.done());
  profiler.advance(10);
  EXPECT_TRUE(profiler.done());
  EXPECT_EQ(profiler.state()[0].x, 0.001);
}

TEST(Profiler, BrakesFirstWhenTheAccelerationIsBeyondItsLimit) {
  Random random(5);
  const int count = test::family(500, 20000);
  Profiler profiler(kLimits, 0.5);
  for (int k = 0; k < count; ++k) {
    Dofs from{};
    Targets target;
    for (int i = 0; i < 4; ++i) target[i] = random.uniform(-0.1, 0.1);
    // |v| stays inside after braking: 3^2 / (2 * 40) = 0.1125 m/s.
    from[0] = {0, random.uniform(-0.1, 0.1), random.integer(0, 1) ? 3.0 : -3.0};
    profiler.reset(from);
    profiler.plan(target);
    double last = 3.0;
    bool inside = false;
    while (!profiler.done()) {
      profiler.advance(0.002);
      const Kinematic& now = profiler.state()[0];
      inside = inside || std::abs(now.a) <= 2.0;
      if (inside) {
        ASSERT_LE(std::abs(now.a), 2.0 + 1e-9);
      } else {
        ASSERT_LT(std::abs(now.a), last);  // on its way back, with full jerk
        last = std::abs(now.a);
      }
      ASSERT_LE(std::abs(now.v), 0.25 + 1e-9);
    }
    ASSERT_TRUE(inside);
    ASSERT_EQ(profiler.state()[0].x, target[0]);
  }
  test::report("random states beyond the limit", count);
}

TEST(Profiler, AVelocityBeyondItsLimitIsNotMadeWorse) {
  Profiler profiler(kLimits, 0.5);
  profiler.reset(Dofs{Kinematic{0, 0.4, 0}, {}, {}, {}});
  profiler.plan({0.2, 0, 0, 0});
  EXPECT_LE(profiler.quintic(0).max_velocity(), 0.4 * (1 + 1e-9));
  profiler.advance(100);
  EXPECT_EQ(profiler.state()[0].x, 0.2);
}

TEST(Profiler, FixedDurationIsTakenAsItIs) {
  Profiler profiler(kLimits, 0.5);
  profiler.reset(Dofs{});
  profiler.plan_fixed({1.0, 0, 0, 0}, 0.5);  // far beyond the limits
  EXPECT_EQ(profiler.duration(), 0.5);
  EXPECT_GT(profiler.quintic(0).max_velocity(), 3.7);
}

TEST(Profiler, IgnoresATargetThatIsNotFinite) {
  Profiler profiler(kLimits, 0.5);
  profiler.reset(Dofs{});
  profiler.plan({0.01, 0, 0, 0});
  profiler.advance(0.1);
  profiler.plan({0, NAN, 0, 0});
  profiler.advance(10);
  EXPECT_EQ(profiler.state()[0].x, 0.01);
  EXPECT_EQ(profiler.state()[1].x, 0);
}

}  // namespace
}  // namespace surg
