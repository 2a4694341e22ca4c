// Estimate of slow streams by several models.
#include <algorithm>
#include <cmath>
#include <functional>

#include "support/test_support.hpp"
#include "surg_core/estimators/hand_estimate.hpp"

namespace surg {
namespace {

using test::Random;

constexpr double kSlowPeriod = 1 / 30.0;

TEST(SwingEstimate, PredictsTheMotionThatItIsMadeFor) {
  // Both parts are known in closed form: a velocity and a swing that fade as they oscillate.
  const SwingModel model{1e-3, 223, 1.7, 9, 1800, 2};
  const double fast = std::sqrt(223 - 0.85 * 0.85), w = 2 * M_PI * 9;
  const auto velocity = [&](double t) { return std::exp(-0.85 * t) * std::cos(fast * t); };
  const auto swing = [&](double t) { return 0.02 * std::exp(-2 * t) * std::sin(w * t); };
  const auto motion = [&](double t) {  // the integral of the velocity, and the swing
    const double k = 0.85 * 0.85 + fast * fast;
    return (0.85 + std::exp(-0.85 * t) * (fast * std::sin(fast * t) - 0.85 * std::cos(fast * t))) /
               k +
           swing(t);
  };
  SwingEstimate estimate(model);
  estimate.reset({motion(0)});
  double t = 0, off = 0;
  for (int k = 1; k <= 40; ++k) {
    const double step = k % 2 ? 0.02 : 0.04;  // the spacing may change
    off = estimate.update({motion(t += step)}, step)[0];
  }
  EXPECT_NEAR(off, 0, 1e-6);
  const double h = 1e-4;
  for (const double age : {-0.01, 0.0, 0.015, 0.033}) {
    const Kinematic now = estimate.predict(age)[0];
    EXPECT_NEAR(now.x, motion(t + age), 2e-6) << age;
    EXPECT_NEAR(now.v, (motion(t + age + h) - motion(t + age - h)) / (2 * h), 2e-4) << age;
    EXPECT_NEAR(now.v, velocity(t + age) + (swing(t + age + h) - swing(t + age - h)) / (2 * h),
                2e-4)
        << age;
    const double a = (motion(t + age + h) - 2 * motion(t + age) + motion(t + age - h)) / (h * h);
    EXPECT_NEAR(now.a, a, 2e-2) << age;
  }
}

TEST(SwingEstimate, StaysFiniteForAnySpacing) {
  Random random(3);
  SwingEstimate estimate(SwingModel{2500, 44, 0.17, 3, 1e9, 0.27});
  estimate.reset({});
  const int count = test::family(20000, 200000);
  for (int k = 0; k < count; ++k) {
    const double spacing = k % 3 ? random.uniform(0, 0.2) : 0.0;
    const double x = random.uniform(-0.1, 0.1);
    estimate.update({x}, spacing);
    ASSERT_LT(std::abs(estimate.predict(0.03)[0].x), 20) << k;
  }
}

/// Largest distance [in amplitudes] between a sine and what is predicted of it up to the next
/// sample, once settled.
double worst_of_sine(double hertz, double rate, bool all_models) {
  HandEstimate hand;
  StreamEstimate plain;
  const auto sine = [&](double t) { return std::sin(2 * M_PI * hertz * t); };
  hand.reset({sine(0)});
  plain.reset({sine(0)});
  double worst = 0;
  for (int k = 1; k < 10 * rate; ++k) {
    hand.update({sine(k / rate)}, 1 / rate, 1 / rate);
    plain.update({sine(k / rate)}, 1 / rate, 1 / rate);
    if (k < 6 * rate) continue;
    for (double age = 0; age <= 1 / rate; age += 0.002) {
      const double x = all_models ? hand.predict(age)[0].x : plain.predict(age)[0].x;
      worst = std::max(worst, std::abs(x - sine(k / rate + age)));
    }
  }
  return worst;
}

TEST(HandEstimate, ASineIsPredictedMuchBetterThanByOneModel) {
  for (const double rate : {25.0, 30.0, 40.0}) {
    for (const double hertz : {1.0, 2.0, 3.0, 5.0, 9.0, 10.0}) {
      const double all = worst_of_sine(hertz, rate, true), one = worst_of_sine(hertz, rate, false);
      EXPECT_LT(all, 0.45 * one) << hertz << " of " << rate << ": " << all << ", " << one;
    }
    EXPECT_LT(worst_of_sine(3, rate, true), 0.1);
  }
}

TEST(HandEstimate, AConstantVelocityIsFoundAndARestToo) {
  for (const double spacing : {0.022, kSlowPeriod, 0.04, 0.1}) {
    HandEstimate hand;
    hand.reset({});
    double x = 0;
    for (int k = 0; k < 4000; ++k) hand.update({x += 0.1 * spacing, -x}, spacing, spacing);
    EXPECT_NEAR(hand.predict(0.02)[0].x, x + 0.002, 1e-6) << spacing;
    EXPECT_NEAR(hand.predict(0.02)[0].v, 0.1, 1e-5);
    EXPECT_NEAR(hand.predict(0.02)[1].v, -0.1, 1e-5);
    for (int k = 0; k < 3000; ++k) hand.update({x, -x}, spacing, spacing);
    EXPECT_NEAR(hand.predict(0.02)[0].x, x, 1e-6) << spacing;
  }
}

TEST(HandEstimate, ItsWeightsHaveNoUnit) {
  // Millimetres or radians: the same motion a thousand times as large is predicted a thousand
  // times as large.
  HandEstimate small, large;
  small.reset({});
  large.reset({});
  for (int k = 1; k < 300; ++k) {
    const double t = k * kSlowPeriod, x = 1e-3 * std::sin(7 * t) + 5e-5 * std::sin(60 * t);
    small.update({x}, kSlowPeriod, kSlowPeriod);
    large.update({1000 * x}, kSlowPeriod, kSlowPeriod);
    ASSERT_NEAR(1000 * small.predict(0.02)[0].x, large.predict(0.02)[0].x, 1e-6) << k;
  }
}

TEST(HandEstimate, StaysFiniteWhateverComes) {
  Random random(7);
  HandEstimate hand;
  hand.reset({});
  const int count = test::family(20000, 200000);
  for (int k = 0; k < count; ++k) {
    const double spacing = k % 50 == 0 ? 0.3 : random.uniform(-0.001, 0.1);
    const double size = std::pow(10, random.uniform(-20, 0));
    const double x = k % 500 < 250 ? size * random.uniform(-1, 1) : 0.1;
    hand.update({x, 0, -x}, spacing, random.uniform(0, 0.06));
    const auto now = hand.predict(random.uniform(-0.02, 0.06));
    // Samples a metre apart may be a microsecond apart.
    ASSERT_LT(std::abs(now[0].x), 1e5) << k;
    ASSERT_EQ(now[1].x, 0) << k;
    ASSERT_TRUE(std::isfinite(now[0].v) && std::isfinite(now[2].a)) << k;
  }
  test::report("samples", count);
}

}  // namespace
}  // namespace surg
