#include <algorithm>
#include <array>
#include <stdexcept>

#include "support.hpp"
#include "surg_core/profiler.hpp"

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

struct Worst {
  double velocity = 0, acceleration = 0, jerk = 0;  // above the limit
};

// Plays a profile to its end and notes by how much it exceeds the limits.
Worst play(Profiler& profiler, double dt) {
  Worst worst;
  Dofs last = profiler.state();
  for (double t = 0; !profiler.done(); t += dt) {
    const double step = std::min(dt, profiler.duration() - t);
    profiler.advance(dt);
    for (int i = 0; i < Profiler::kDof; ++i) {
      const Kinematic& now = profiler.state()[i];
      worst.velocity = std::max(worst.velocity, std::abs(now.v) - kLimits[i].velocity);
      worst.acceleration = std::max(worst.acceleration, std::abs(now.a) - kLimits[i].acceleration);
      // The mean jerk of a step, where the step is long enough to divide by.
      if (step > 0.5 * dt) {
        worst.jerk = std::max(worst.jerk, std::abs(now.a - last[i].a) / step - kLimits[i].jerk);
      }
      last[i] = now;
    }
  }
  return worst;
}

TEST(Profiler, NeverExceedsTheLimitsAndEndsAtRestAtTheTarget) {
  Random random(1);
  const int count = test::family(2000, 100000);
  Profiler profiler(kLimits, 0.5);
  Worst worst;
  double longest = 0;
  for (int k = 0; k < count; ++k) {
    Dofs from;
    Targets target;
    for (int i = 0; i < 4; ++i) {
      from[i] = keepable_state(random, kLimits[i]);
      target[i] = from[i].x + random.uniform(-1, 1) * random.magnitude(1e-4, 0.3);
    }
    profiler.reset(from);
    profiler.plan(target);
    const Worst run = play(profiler, 0.002);
    ASSERT_LE(run.velocity, 1e-9) << "family member " << k;
    ASSERT_LE(run.acceleration, 1e-9) << "family member " << k;
    ASSERT_LE(run.jerk, 1e-6) << "family member " << k;
    for (int i = 0; i < 4; ++i) {
      ASSERT_EQ(profiler.state()[i].x, target[i]);
      ASSERT_EQ(profiler.state()[i].v, 0);
      ASSERT_EQ(profiler.state()[i].a, 0);
    }
    longest = std::max(longest, profiler.duration());
  }
  EXPECT_LT(longest, 12.0);
  test::report("random states", count);
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

TEST(Profiler, ReplanningOnTheWayKeepsTheLimits) {
  Random random(3);
  const int count = test::family(200, 10000);
  Profiler profiler(kLimits, 0.5);
  profiler.reset(Targets{0, 0, 0, 0});
  for (int k = 0; k < count; ++k) {
    Targets target;
    for (double& x : target) x = random.uniform(-0.15, 0.15);
    profiler.plan(target);
    const int steps = random.integer(1, 400);
    for (int n = 0; n < steps; ++n) {
      profiler.advance(0.002);
      for (int i = 0; i < 4; ++i) {
        ASSERT_LE(std::abs(profiler.state()[i].v), kLimits[i].velocity + 1e-9);
        ASSERT_LE(std::abs(profiler.state()[i].a), kLimits[i].acceleration + 1e-9);
      }
    }
  }
  test::report("changes of mind", count);
}

TEST(Profiler, RestToRestTakesTheLeastDuration) {
  Random random(4);
  const int count = test::family(2000, 50000);
  Profiler profiler(kLimits, 0.5);
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
    profiler.reset(Targets{0, 0, 0, 0});
    profiler.plan(target);
    ASSERT_NEAR(profiler.duration(), expected, 1e-9 * expected);
  }
  test::report("random distances", count);
}

TEST(Profiler, BaseDurationIsThePapers) {
  Profiler profiler(kLimits, 0.5);
  profiler.reset(Targets{0, 0, 0, 0});
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
  profiler.reset(Targets{0, 0, 0, 0});
  profiler.plan_fixed({1.0, 0, 0, 0}, 0.5);  // far beyond the limits
  EXPECT_EQ(profiler.duration(), 0.5);
  EXPECT_GT(profiler.quintic(0).max_velocity(), 3.7);
}

TEST(Profiler, IgnoresATargetThatIsNotFinite) {
  Profiler profiler(kLimits, 0.5);
  profiler.reset(Targets{0, 0, 0, 0});
  profiler.plan({0.01, 0, 0, 0});
  profiler.advance(0.1);
  profiler.plan({0, NAN, 0, 0});
  profiler.advance(10);
  EXPECT_EQ(profiler.state()[0].x, 0.01);
  EXPECT_EQ(profiler.state()[1].x, 0);
}

TEST(Profiler, RefusesLimitsThatAreNotPositive) {
  EXPECT_THROW(Profiler({kTip, kTip, kTip, DofLimits{1, 0, 1}}, 0.5), std::invalid_argument);
  EXPECT_THROW(Profiler({kTip, kTip, kTip, DofLimits{NAN, 1, 1}}, 0.5), std::invalid_argument);
  EXPECT_THROW(Profiler(kLimits, 0), std::invalid_argument);
}

TEST(Profiler, LeavesTheHeapAlone) {
  if (!SURG_HEAP_IS_WATCHED) GTEST_SKIP() << "the heap cannot be watched in this build";
  Profiler profiler(kLimits, 0.5);
  test::HeapWatch heap;
  profiler.reset(Dofs{Kinematic{0, 0.1, 1.9}, {}, {}, {}});
  profiler.plan({0.05, -0.02, 0.1, 1});
  profiler.advance(0.002);
  profiler.plan_fixed({0.05, -0.02, 0.1, 1}, 0.5);
  profiler.advance(0.002);
  EXPECT_EQ(heap.calls(), 0);
}

}  // namespace
}  // namespace surg
