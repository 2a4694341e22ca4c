#include <algorithm>

#include "support/test_support.hpp"
#include "surg_core/motion/quintic.hpp"

namespace surg {
namespace {

using test::Random;

Kinematic random_state(Random& random, double scale) {
  return {scale * random.normal(), scale * random.normal(), scale * random.normal()};
}

TEST(Quintic, MeetsBothEnds) {
  Random random(1);
  const int count = test::family(10000, 200000);
  for (int k = 0; k < count; ++k) {
    const double scale = random.magnitude(1e-3, 10), d = random.magnitude(0.01, 100);
    const Kinematic from = random_state(random, scale), to = random_state(random, scale);
    const Quintic q(from, to, d);
    const Kinematic start = q.at(0), end = q.at(d), before = q.at(d * (1 - 1e-9));
    const double tolerance = 1e-13 * scale * (1 + d * d) * 10;
    ASSERT_NEAR(start.x, from.x, tolerance);
    ASSERT_NEAR(start.v, from.v, tolerance);
    ASSERT_NEAR(start.a, from.a, tolerance);
    ASSERT_EQ(end.x, to.x);
    ASSERT_EQ(end.v, to.v);
    ASSERT_EQ(end.a, to.a);
    // The polynomial itself gets there too, not only the answer at the end.
    const double reach = scale * (1 + d * d);
    ASSERT_NEAR(before.x, to.x, 1e-6 * reach);
    ASSERT_NEAR(before.v, to.v, 1e-6 * reach / std::min(d, 1.0));
    ASSERT_NEAR(before.a, to.a, 1e-6 * reach / std::min(d * d, 1.0));
  }
  test::report("random quintics", count);
}

TEST(Quintic, DerivativesBelongTogether) {
  Random random(2);
  const int count = test::family(1000, 20000);
  for (int k = 0; k < count; ++k) {
    const Quintic q(random_state(random, 1), random_state(random, 1), 1.0);
    const double t = random.uniform(0.01, 0.99), h = 1e-5;
    const Kinematic below = q.at(t - h), here = q.at(t), above = q.at(t + h);
    ASSERT_NEAR((above.x - below.x) / (2 * h), here.v, 1e-6);
    ASSERT_NEAR((above.v - below.v) / (2 * h), here.a, 1e-5);
  }
  test::report("random quintics", count);
}

TEST(Quintic, ExtremesAreThoseOfDenseSampling) {
  Random random(3);
  const int count = test::family(2000, 50000), samples = 2000;
  for (int k = 0; k < count; ++k) {
    const double d = random.magnitude(0.05, 20);
    Kinematic from = random_state(random, 1), to = random_state(random, 1);
    if (random.integer(0, 2) == 0) to.v = to.a = 0;
    if (random.integer(0, 4) == 0) from.v = from.a = 0;
    if (random.integer(0, 9) == 0) to = from;
    const Quintic q(from, to, d);
    double v = 0, a = 0, j = 0, a_last = from.a;
    for (int i = 0; i <= samples; ++i) {
      const double t = d * i / samples;
      const Kinematic s = q.at(t);
      v = std::max(v, std::abs(s.v));
      a = std::max(a, std::abs(s.a));
      if (i > 0) j = std::max(j, std::abs(s.a - a_last) / (d / samples));
      a_last = s.a;
    }
    const double rounding = 1 + 1e-12, grid = 1 - 1e-5;
    ASSERT_LE(v, q.max_velocity() * rounding);
    ASSERT_LE(a, q.max_acceleration() * rounding);
    ASSERT_LE(j, q.max_jerk() * (1 + 1e-9));
    ASSERT_GE(v, q.max_velocity() * grid);
    ASSERT_GE(a, q.max_acceleration() * grid);
    ASSERT_GE(j, q.max_jerk() * 0.99);
  }
  test::report("random quintics, 2001 samples each", count);
}

TEST(Quintic, RestToRestHasTheKnownPeaks) {
  const double D = 0.1, d = 0.8;
  const Quintic q({0, 0, 0}, {D, 0, 0}, d);
  EXPECT_NEAR(q.max_velocity(), 15 * D / (8 * d), 1e-15);
  EXPECT_NEAR(q.max_acceleration(), 10 * D / (std::sqrt(3.0) * d * d), 1e-14);
  EXPECT_NEAR(q.max_jerk(), 60 * D / (d * d * d), 1e-12);
}

TEST(Quintic, WithoutDurationStandsAtTheEnd) {
  for (double d : {0.0, -1.0, static_cast<double>(NAN)}) {
    const Quintic q({1, 2, 3}, {4, 0, 0}, d);
    EXPECT_EQ(q.duration(), 0);
    EXPECT_EQ(q.at(0).x, 4);
    EXPECT_EQ(q.at(1).v, 0);
    EXPECT_EQ(q.max_velocity(), 0);
  }
}

TEST(Quintic, IsClampedToItsTime) {
  const Quintic q({1, 0, 0}, {2, 0, 0}, 1);
  EXPECT_EQ(q.at(-5).x, 1);
  EXPECT_EQ(q.at(5).x, 2);
}

}  // namespace
}  // namespace surg
