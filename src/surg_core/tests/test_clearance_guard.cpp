// The clearance guard beside a wall: whatever share of the way back a step takes, it does not
// close.
#include <gtest/gtest.h>

#include <random>

#include "support/test_arm.hpp"
#include "surg_core/limits/clearance.hpp"

namespace surg {
namespace {

constexpr double kDistance = 0.02;  // [m]

/// A UR5e without an instrument; two capsules, and a wall that the forearm nearly touches.
struct WallScene {
  explicit WallScene(const Vector3& normal) {
    setup.distance = kDistance;
    setup.own.chain = test::ur5e_chain();
    setup.own.capsules = {{"upper_arm", 1, {{0, 0, 0}, {-0.425, 0, 0}, 0.07}, false},
                          {"forearm", 2, {{0, 0, 0}, {-0.39, 0, 0}, 0.06}, false}};
    Obstacle wall;
    wall.name = "wall";
    wall.half_space = true;
    wall.space.normal = normal;
    setup.obstacles = {wall};
  }

  /// Distance of the arm to a wall through the origin [m].
  double height(const JointVector& q) const {
    double least = INFINITY;
    const auto rows = placed(setup.own, q);
    for (Eigen::Index i = 0; i < rows.rows(); ++i) {
      for (const int at : {0, 3}) {
        const Vector3 p = rows.row(i).segment<3>(at);
        least = std::min(least, setup.obstacles[0].space.normal.dot(p) - rows(i, 6));
      }
    }
    return least;
  }

  ClearanceSetup setup;
};

TEST(ClearanceGuard, APartThatMayWaitIsNotCountedAsMotionAway) {
  std::mt19937 rng(7);
  std::normal_distribution<double> normal;
  const auto drawn = [&](double scale) {
    JointVector v(6);
    for (double& x : v) x = scale * normal(rng);
    return v;
  };
  const JointVector acceleration = JointVector::Constant(6, 15.0);
  int away = 0, limited = 0;
  for (int k = 0; k < 2000; ++k) {
    WallScene scene(Vector3(normal(rng), normal(rng), normal(rng)).normalized());
    const JointVector q = drawn(1.0), back = drawn(0.05), qd1 = drawn(0.3);
    // 0.1 mm inside what the guard holds in reserve: nothing may close any more.
    scene.setup.obstacles[0].space.point =
        (scene.height(q) - kDistance - 0.0019) * scene.setup.obstacles[0].space.normal;
    const ClearanceGuard guard(scene.setup, 0.0, 0.002);
    const auto rate = [&](const JointVector& qd) {
      return (scene.height(q + 1e-6 * qd) - scene.height(q - 1e-6 * qd)) / 2e-6;
    };
    const double alpha = std::min(guard.cap(q, back, back, qd1, acceleration), 1.0);
    limited += alpha < 1;
    if (rate(back) < 0) continue;
    ++away;
    for (const double beta : {0.0, 0.4, 1.0}) {
      EXPECT_GT(rate(beta * back + alpha * qd1), -1e-6) << "draw " << k << ", share " << beta;
    }
  }
  std::printf("%d of 2000 draws with a way back that leads away, %d limited\n", away, limited);
  EXPECT_GT(away, 500);
  EXPECT_GT(limited, 500);
}

}  // namespace
}  // namespace surg
