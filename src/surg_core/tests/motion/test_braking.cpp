#include <algorithm>
#include <cmath>

#include "support/stop_oracle.hpp"
#include "support/test_support.hpp"
#include "surg_core/motion/braking.hpp"

namespace surg {
namespace {

using test::Random;

const DofLimits kTip{0.25, 2.0, 40.0};

DofLimits random_limits(Random& random) {
  return {random.magnitude(0.01, 5), random.magnitude(0.1, 100), random.magnitude(1, 5000)};
}

Kinematic random_state(Random& random, const DofLimits& limits, double beyond = 1) {
  Kinematic s{random.normal(), beyond * limits.velocity * random.uniform(-1, 1),
              beyond * limits.acceleration * random.uniform(-1, 1)};
  if (random.integer(0, 4) == 0) s.a = 0;
  if (random.integer(0, 9) == 0) s.v = 0;
  return s;
}

TEST(Braking, StopsAtRestWithinItsLimits) {
  Random random(1);
  const int count = test::family(20000, 300000), samples = 60;
  for (int k = 0; k < count; ++k) {
    const DofLimits limits = random_limits(random);
    const Kinematic from = random_state(random, limits, random.integer(0, 3) == 0 ? 2 : 1);
    const Braking stop = Braking::stop(from, limits);
    const double d = stop.duration(), h = d / samples;
    const double A = std::max(limits.acceleration, std::abs(from.a));
    ASSERT_EQ(stop.at(d).v, 0);
    ASSERT_EQ(stop.at(d).a, 0);
    ASSERT_DOUBLE_EQ(stop.at(10 * d + 1).x, stop.at(d).x);
    ASSERT_EQ(stop.at(-1).v, from.v);
    const double rounding = 1e-12 * (std::abs(from.v) + A * A / limits.jerk);
    Kinematic last = from;
    int turns = 0;
    for (int i = 1; i <= samples; ++i) {
      const Kinematic now = stop.at(i * h);
      ASSERT_LE(std::abs(now.a), A * (1 + 1e-9));
      ASSERT_LE(std::abs(now.a - last.a), limits.jerk * h * (1 + 1e-9) + 1e-12 * A);
      // Trapezium and midpoint differ by less than the jerk can bend the curve.
      ASSERT_NEAR(now.v - last.v, 0.5 * (now.a + last.a) * h,
                  0.25 * limits.jerk * h * h + rounding);
      ASSERT_NEAR(now.x - last.x, 0.5 * (now.v + last.v) * h,
                  0.25 * A * h * h + 1e-13 * (std::abs(now.x) + std::abs(now.v) * d));
      turns += now.v * last.v < 0 && std::abs(now.v) > rounding;
      last = now;
    }
    ASSERT_LE(turns, 1);
    if (from.a * from.v >= 0) {
      ASSERT_EQ(turns, 0);
    }
  }
  test::report("random stops, 60 samples each", count);
}

TEST(Braking, DistanceFromUniformMotionIsTheKnownOne) {
  for (const double v : {0.01, 0.1, 0.25, 1.0, -0.25}) {
    const double V = std::abs(v), A = kTip.acceleration, J = kTip.jerk;
    const double expected = V * J <= A * A ? V * std::sqrt(V / J) : V / 2 * (V / A + A / J);
    EXPECT_NEAR(Braking::stop({3, v, 0}, kTip).distance(), std::copysign(expected, v), 1e-15);
  }
  EXPECT_NEAR(Braking::stop({0, 0.25, 0}, kTip).distance(), 0.021875, 1e-15);
}

TEST(Braking, DistanceIsThatOfAFeedbackLaw) {
  Random random(2);
  const int count = test::family(300, 3000);
  double worst = 0;
  for (int k = 0; k < count; ++k) {
    const DofLimits limits = random_limits(random);
    const Kinematic from = random_state(random, limits, random.integer(0, 3) == 0 ? 2 : 1);
    const Braking stop = Braking::stop(from, limits);
    const double h = stop.duration() / 20000;
    if (h == 0) continue;
    const double scale = (std::abs(from.v) + std::abs(from.a) * stop.duration()) * stop.duration();
    worst = std::max(worst,
                     std::abs(stop.distance() - test::stop_by_feedback(from, limits, h)) / scale);
  }
  EXPECT_LT(worst, 1e-3);
  test::report("random stops by small steps", count);
  std::printf("[  figures ] largest relative difference %.1e\n", worst);
}

TEST(Braking, EaseGoesOnAtTheVelocityReached) {
  const Braking ease = Braking::ease({0, 0.1, -1.0}, kTip);
  EXPECT_DOUBLE_EQ(ease.duration(), 0.025);
  EXPECT_DOUBLE_EQ(ease.at(1).v, 0.1 - 0.0125);
  EXPECT_EQ(ease.at(1).a, 0);
  EXPECT_NEAR(ease.at(1.5).x - ease.at(0.5).x, 0.0875, 1e-15);
}

TEST(Braking, AtRestNeedsNothing) {
  const Braking stop = Braking::stop({2, 0, 0}, kTip);
  EXPECT_EQ(stop.duration(), 0);
  EXPECT_EQ(stop.distance(), 0);
  EXPECT_EQ(stop.at(1).x, 2);
  EXPECT_EQ(Braking().at(3).x, 0);
}

}  // namespace
}  // namespace surg
