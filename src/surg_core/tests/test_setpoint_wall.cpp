#include <algorithm>
#include <cmath>

#include "support.hpp"
#include "surg_core/limits.hpp"
#include "surg_core/setpoint.hpp"

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
double worst_outside(Space space, int count, unsigned seed) {
  const double T = 0.002;
  const Limits limits = workspace();
  Random random(seed);
  double worst = -1;
  for (int k = 0; k < count; ++k) {
    Vector3 hand;
    do {
      hand = {random.uniform(-0.18, 0.18), random.uniform(-0.18, 0.18), random.uniform(0.02, 0.22)};
    } while (outside_workspace(limits, hand) > -0.02);
    Setpoint setpoint(limits, 0.5, false);
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
        setpoint.follow(space, {dofs[0].x, dofs[1].x, dofs[2].x, 0}, T);
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

}  // namespace
}  // namespace surg
