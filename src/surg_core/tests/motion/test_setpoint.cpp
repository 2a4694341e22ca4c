#include <algorithm>
#include <array>
#include <cmath>

#include "support/test_support.hpp"
#include "surg_core/limits/workspace.hpp"
#include "surg_core/motion/setpoint.hpp"

namespace surg {
namespace {

using test::Random;

Limits workspace() {
  Limits limits;
  limits.depth_min = 0.02, limits.depth_slow = 0.03, limits.depth_max = 0.22;
  limits.cone = M_PI / 3;
  limits.tip_velocity = 0.25, limits.tip_acceleration = 2, limits.tip_jerk = 100;
  limits.roll_velocity = 2, limits.roll_acceleration = 25, limits.roll_jerk = 500;
  limits.pivot_velocity = 1.5, limits.pivot_acceleration = 16, limits.pivot_jerk = 830;
  limits.stop_deceleration = 4;
  return limits;
}

Vector3 direction(Random& random) {
  return Vector3(random.normal(), random.normal(), random.normal()).normalized();
}

// A hand runs into the wall at up to the tip's own limit and stops there dead: every target is
// inside, but the filter comes too fast for its own way of slowing down.
double worst_outside(Space space, int count, unsigned seed, double stream_delay = 0) {
  const double T = 0.002;
  const Limits limits = workspace();
  Random random(seed);
  double worst = -1;
  for (int k = 0; k < count; ++k) {
    Vector3 hand;
    do {
      hand = {random.uniform(-0.18, 0.18), random.uniform(-0.18, 0.18), random.uniform(0.02, 0.22)};
    } while (outside_workspace(limits, hand) > -0.02);
    Setpoint setpoint(limits, {0.5, false, stream_delay, 0});
    setpoint.reset(hand, hand.normalized(), 0);
    Vector3 velocity = Vector3::Zero();
    const int spacing = k % 2 == 0 ? 1 : 17;  // ticks: 500 or 30 Hz
    for (int i = 0; i < 450; ++i) {
      if (i % 150 == 0) velocity = random.uniform(0.05, 0.25) * direction(random);
      const Vector3 next = hand + velocity * T;
      if (outside_workspace(limits, next) < 0) hand = next;
      if (i % spacing == 0) {
        const Dofs cartesian{Kinematic{hand.x(), 0, 0}, Kinematic{hand.y(), 0, 0},
                             Kinematic{hand.z(), 0, 0}, Kinematic{}};
        const Dofs dofs = space == Space::kCartesian ? cartesian : to_spherical(cartesian);
        setpoint.add_stream_sample(space, {dofs[0].x, dofs[1].x, dofs[2].x, 0});
      }
      setpoint.elapse(T);
      setpoint.advance(T);
      worst = std::max(worst, outside_workspace(limits, setpoint.p_RTip()));
    }
  }
  return worst;
}

TEST(SetpointWall, AStreamStopsAtTheWall) {
  const int count = test::family(300, 10000);
  const double cartesian = worst_outside(Space::kCartesian, count, 1);
  const double spherical = worst_outside(Space::kSpherical, count, 2);
  EXPECT_LT(cartesian, 0.5e-3);
  EXPECT_LT(spherical, 0.5e-3);
  test::report("hands that run into the wall, in each space", count);
  std::printf("[  figures ] farthest outside: %.2f mm (servo_cp), %.2f mm (servo_jp)\n",
              1e3 * cartesian, 1e3 * spherical);
}

TEST(SetpointWall, ADelayedStreamStopsThereToo) {
  const int count = test::family(100, 3000);
  const double cartesian = worst_outside(Space::kCartesian, count, 3, 0.05);
  const double spherical = worst_outside(Space::kSpherical, count, 4, 0.05);
  EXPECT_LT(cartesian, 0.5e-3);
  EXPECT_LT(spherical, 0.5e-3);
  test::report("hands that run into the wall, followed 50 ms later, in each space", count);
}

// From any speed a stop takes v / a and v^2 / 2a; where a limit has slowed the clock to a share of
// itself, the tip's own speed is that share of the profile's, and the stop begins there.
TEST(SetpointStop, TakesItsDecelerationFromTheTipsOwnSpeed) {
  const double T = 0.002;
  const Limits limits = workspace();
  Random random(5);
  const int count = test::family(100, 2000);
  for (int k = 0; k < count; ++k) {
    const double share = k % 2 == 0 ? 1 : random.uniform(0.2, 1);
    const Vector3 v = random.uniform(0.05, 0.24) * direction(random);
    Setpoint setpoint(limits, {});
    setpoint.reset(Vector3(0, 0, 0.12), Vector3::UnitZ(), 0);
    for (int i = 0; i < 75; ++i) {
      setpoint.set_velocity(Space::kCartesian, {v.x(), v.y(), v.z(), 0});
      setpoint.elapse(T);
      setpoint.advance(T);
    }
    setpoint.elapse(T);
    setpoint.advance(share * T);
    const double speed = share * setpoint.v_RTip().norm();
    const Vector3 from = setpoint.p_RTip();
    ASSERT_GT(speed, 0.005);
    setpoint.stop();
    int ticks = 0;
    for (; setpoint.mode() != Setpoint::Mode::kRest && ticks < 1000; ++ticks) {
      setpoint.elapse(T);
      setpoint.advance(T);
    }
    const double a = limits.stop_deceleration;
    EXPECT_NEAR(ticks * T, speed / a, 2 * T);
    EXPECT_NEAR((setpoint.p_RTip() - from).norm(), speed * speed / (2 * a), speed * T);
  }
  test::report("stops", count);
}

// A hand that swings far too fast about the trocar: the set-point's yaw and pitch, by finite
// differences, keep their limits and use them.
TEST(SetpointLimits, AFastStreamAboutThePivotKeepsThePivotsLimits) {
  const double T = 0.002;
  const Limits limits = workspace();
  for (const int axis : {0, 1}) {
    Setpoint setpoint(limits, {0.5, false, 0, 0});
    Dofs start{};
    start[axis].x = -0.5;
    start[2].x = 0.12;
    const Dofs tip = to_cartesian(start);
    const Vector3 p(tip[0].x, tip[1].x, tip[2].x);
    setpoint.reset(p, p.normalized(), 0);
    std::array<double, 4> at;
    at.fill(setpoint.joints()[axis]);
    double velocity = 0, acceleration = 0, jerk = 0;
    for (int k = 1; k <= 1000; ++k) {
      std::array<double, 4> target{0, 0, 0.12, 0};
      target[axis] = std::min(-0.5 + 4 * k * T, 0.5);
      setpoint.add_stream_sample(Space::kSpherical, target);
      setpoint.elapse(T);
      setpoint.advance(T);
      at = {at[1], at[2], at[3], setpoint.joints()[axis]};
      velocity = std::max(velocity, std::abs(at[3] - at[2]) / T);
      acceleration = std::max(acceleration, std::abs(at[3] - 2 * at[2] + at[1]) / (T * T));
      jerk = std::max(jerk, std::abs(at[3] - 3 * at[2] + 3 * at[1] - at[0]) / (T * T * T));
    }
    EXPECT_NEAR(velocity / limits.pivot_velocity, 0.975, 0.026);
    EXPECT_NEAR(acceleration / limits.pivot_acceleration, 0.95, 0.051);
    EXPECT_NEAR(jerk / limits.pivot_jerk, 0.75, 0.251);
  }
}

// A circle, then silence: late by the delay, and at rest at the last sample.
TEST(SetpointDelay, FollowsItsStreamLaterAndComesToRestAtItsEnd) {
  const double T = 0.002, w = 2 * M_PI * 0.5;
  const auto hand = [w](double t) {
    return Vector3(0.02 * std::sin(w * t), 0.02 * (1 - std::cos(w * t)), 0.12);
  };
  for (const Space space : {Space::kCartesian, Space::kSpherical}) {
    for (const double D : {0.0, 0.05}) {
      Setpoint setpoint(workspace(), {0.5, false, D, 0});
      setpoint.reset(hand(0), hand(0).normalized(), 0);
      double worst = 0;
      int k = 1;
      for (; k <= 2000; ++k) {
        const Vector3 p = hand(k * T);
        const Dofs cartesian{Kinematic{p.x(), 0, 0}, Kinematic{p.y(), 0, 0}, Kinematic{p.z(), 0, 0},
                             Kinematic{}};
        const Dofs dofs = space == Space::kCartesian ? cartesian : to_spherical(cartesian);
        setpoint.add_stream_sample(space, {dofs[0].x, dofs[1].x, dofs[2].x, 0});
        setpoint.elapse(T);
        setpoint.advance(T);
        // At the end of the coming cycle; the estimate is one more ahead. The hand is gentle.
        const double behind = std::min(D, 0.008) - 2 * T;
        if (k > 500) worst = std::max(worst, (setpoint.p_RTip() - hand(k * T - behind)).norm());
      }
      const Vector3 last = hand(2000 * T);
      for (k = 0; k < 50; ++k) {
        setpoint.elapse(T);
        setpoint.advance(T);
      }
      std::printf(
          "[  figures ] delay %2.0f ms: off the delayed circle %.3f mm; 0.1 s after the "
          "last sample %.3f mm from it at %.2f mm/s\n",
          1e3 * D, 1e3 * worst, 1e3 * (setpoint.p_RTip() - last).norm(),
          1e3 * setpoint.v_RTip().norm());
      EXPECT_LT(worst, 0.15e-3);
      EXPECT_LT((setpoint.p_RTip() - last).norm(), 1e-3);  // it stopped dead, from 63 mm/s
    }
  }
}

}  // namespace
}  // namespace surg
