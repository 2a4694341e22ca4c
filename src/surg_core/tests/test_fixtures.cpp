// Virtual fixtures: walls of random regions in front of random motions of two lagging arms. The
// distances are the test's own, and they are the arm's, not the set-point's.
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "support/fixture_bench.hpp"
#include "support/test_support.hpp"
#include "surg_core/limits/slide.hpp"

namespace surg {
namespace {

using test::allowed_by;
using test::fixture;
using test::FixtureBench;
using test::kT;
using Shape = Fixture::Shape;
using Side = Fixture::Side;

constexpr double kSetTolerance = 1e-6;  // [m] of the set-point beyond a wall
constexpr double kArmTolerance = 1e-3;  // [m] of the arm beyond a wall

const Vector3 kStart(0, 0, 0.12);

Vector3 direction(test::Random& random) {
  return Vector3(random.normal(), random.normal(), random.normal()).normalized();
}

/// A region that allows the start, its wall 2 to 25 mm from it.
Fixture random_region(test::Random& random, const char* name) {
  const int kind = random.integer(0, 5);
  const Vector3 to = direction(random), across = to.cross(direction(random)).normalized();
  const double gap = random.uniform(0.002, 0.025), r = random.uniform(0.004, 0.03);
  const Vector3 wall = kStart + gap * to;
  switch (kind) {
    case 0:
      return fixture(name, Shape::kPlane, Side::kKeepOut, wall, to, 0);
    case 1:
      return fixture(name, Shape::kPlane, Side::kStayIn, wall, -to, 0);
    case 2:
      return fixture(name, Shape::kSphere, Side::kKeepOut, wall + r * to, Vector3::Zero(), r);
    case 3: {
      const double large = gap + random.uniform(0.005, 0.04);
      return fixture(name, Shape::kSphere, Side::kStayIn, wall - large * to, Vector3::Zero(),
                     large);
    }
    case 4: {
      const double half = random.uniform(0.005, 0.04);
      return fixture(name, Shape::kCapsule, Side::kKeepOut, wall + r * to - half * across,
                     2 * half * across, r);
    }
    default: {
      const double large = gap + random.uniform(0.005, 0.03), half = random.uniform(0.01, 0.04);
      return fixture(name, Shape::kCapsule, Side::kStayIn, wall - large * to - half * across,
                     2 * half * across, large);
    }
  }
}

/// A hand: sines of random size, direction and speed about the start.
class Hand {
 public:
  Hand(test::Random& random, double largest) {
    for (int i = 0; i < 4; ++i) {
      size_[i] = random.uniform(0.2, 1) * largest / (1 + i) * direction(random);
      rate_[i] = 2 * M_PI * (1 + i) * random.uniform(0.1, 0.35);
      phase_[i] = random.uniform(0, 2 * M_PI);
    }
  }
  Vector3 at(double t) const {
    Vector3 p = kStart;
    for (int i = 0; i < 4; ++i) {
      p += size_[i] * (std::sin(rate_[i] * t + phase_[i]) - std::sin(phase_[i]));
    }
    p = kStart + (p - kStart) * std::min(1.0, 0.07 / std::max(1e-9, (p - kStart).norm()));
    return p;
  }

 private:
  std::array<Vector3, 4> size_;
  std::array<double, 4> rate_, phase_;
};

enum class Kind { kStream, kVelocity, kMove };

void drive(FixtureBench& bench, Kind kind, double seconds, long& refused) {
  const Hand hand(bench.random, 0.04);
  Vector3 v = Vector3::Zero();
  for (int i = 0; i < std::lround(seconds / kT); ++i) {
    const double t = i * kT;
    if (kind == Kind::kStream) bench.servo_cp(hand.at(t));
    if (kind == Kind::kVelocity) {
      if (i % 200 == 0) v = bench.random.uniform(0.02, 0.15) * direction(bench.random);
      bench.servo_cv(v);
    }
    if (kind == Kind::kMove && i % 300 == 0) {
      bench.pose(Motion::kMoveCp,
                 kStart + bench.random.uniform(0.0, 0.04) * direction(bench.random));
    }
    const std::uint32_t before = bench.out().refused;
    bench.tick();
    refused += bench.out().refused - before;
    ASSERT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
  }
}

class EachArm : public testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(Arms, EachArm, testing::Values(false, true), [](const auto& info) {
  return info.param ? std::string("Panda") : std::string("UR5e");
});

/// Worst figures of a family of random motions, by kind of motion.
struct Worst {
  std::array<double, 3> arm{}, set{}, pivot{};
  double hardest = 0;
  long cycles = 0, refused = 0, at_wall = 0;
};

Worst random_family(bool panda, int runs, bool walls) {
  Worst worst;
  for (int run = 0; run < runs; ++run) {
    for (const Kind kind : {Kind::kStream, Kind::kVelocity, Kind::kMove}) {
      FixtureBench bench(panda, 1000 + run);
      const int n = bench.random.integer(1, 3);
      for (int i = 0; i < n; ++i) {
        Fixture region = random_region(bench.random, std::string(1, 'a' + i).c_str());
        if (walls) EXPECT_EQ(bench.put(region), Reason::kNone);
      }
      bench.forget();
      drive(bench, kind, 4, worst.refused);
      const int k = static_cast<int>(kind);
      worst.arm[k] = std::max(worst.arm[k], bench.deepest);
      worst.set[k] = std::max(worst.set[k], bench.deepest_set);
      worst.pivot[k] = std::max(worst.pivot[k], bench.off_pivot);
      worst.hardest = std::max(worst.hardest, bench.hardest);
      worst.at_wall += bench.out().reason == Reason::kFixture;
      worst.cycles += bench.ticks;
    }
  }
  return worst;
}

TEST_P(EachArm, RandomMotionsStayOnTheAllowedSideOfRandomRegions) {
  const int runs = test::family(12, 400);
  const Worst free = random_family(GetParam(), runs, false);
  const Worst walled = random_family(GetParam(), runs, true);
  test::report("cycles with regions", walled.cycles);
  test::report("moves refused", walled.refused);
  test::report("runs that end on a wall", walled.at_wall);
  for (int k = 0; k < 3; ++k) {
    std::printf(
        "[   worst  ] %s: arm %.0f um and set-point %.1f um beyond a wall; pivot %.0f um, "
        "without regions %.0f um\n",
        k == 0   ? "streams"
        : k == 1 ? "velocities"
                 : "moves",
        walled.arm[k] * 1e6, walled.set[k] * 1e6, walled.pivot[k] * 1e6, free.pivot[k] * 1e6);
    // Sudden velocities are more than a Panda's joints can brake: a little above the tolerance.
    const bool weak = GetParam() && k == 1;
    EXPECT_LE(walled.arm[k], (weak ? 1.1 : 1) * kArmTolerance);
    EXPECT_LE(walled.set[k], weak ? 1.1 * kArmTolerance : kSetTolerance);
    EXPECT_LE(walled.pivot[k], 1.3 * free.pivot[k]);
  }
  EXPECT_LE(walled.hardest, 1 + 1e-9);
  EXPECT_GT(walled.at_wall, runs / 4);
  EXPECT_GT(walled.refused, 0);
}

Fixture floor_at(double depth) {
  return fixture("floor", Shape::kPlane, Side::kKeepOut, Vector3(0, 0, depth), Vector3::UnitZ(), 0);
}

TEST_P(EachArm, AHandThatPressesIntoAWallSlidesAlongItAndLeavesAtOnce) {
  FixtureBench walled(GetParam(), 1), free(GetParam(), 1);
  ASSERT_EQ(walled.put(floor_at(0.125)), Reason::kNone);
  double tangential = 0, left = 0;
  for (int i = 0; i < 3000; ++i) {
    const double t = i * kT, press = t < 4 ? 0.02 * std::min(1.0, t) : 0.02 - 0.05 * (t - 4);
    const Vector3 hand(0.02 * std::sin(M_PI * t), 0.01 * std::sin(2 * M_PI * t), 0.12 + press);
    const Vector3 on_wall(hand.x(), hand.y(), std::min(hand.z(), 0.125));
    walled.servo_cp(hand);
    free.servo_cp(on_wall);
    walled.tick();
    free.tick();
    const Vector3 between = walled.tip_R() - free.tip_R();
    if (t > 0.5) tangential = std::max(tangential, between.head<2>().norm());
    if (t > 1.5 && t < 4) EXPECT_EQ(walled.out().reason, Reason::kFixture);
    if (t > 4.35 && t < 4.7) left = std::max(left, std::abs(between.z()));
  }
  std::printf(
      "[   worst  ] along the wall %.0f um; 50 ms after leaving it %.0f um; beyond it %.0f "
      "um\n",
      tangential * 1e6, left * 1e6, walled.deepest * 1e6);
  EXPECT_LE(tangential, 3e-4);
  EXPECT_LE(left, GetParam() ? 1e-3 : 5e-4);
  EXPECT_LE(walled.deepest, kArmTolerance);
  EXPECT_LE(walled.hardest, 1 + 1e-9);
  EXPECT_EQ(walled.out().reason, Reason::kNone);
}

TEST_P(EachArm, AVelocityIntoAWallSlidesAndOneAwayMovesAtOnce) {
  FixtureBench bench(GetParam(), 2);
  ASSERT_EQ(bench.put(floor_at(0.125)), Reason::kNone);
  const auto run = [&](const Vector3& v, double seconds) {
    for (int i = 0; i < std::lround(seconds / kT); ++i) {
      bench.servo_cv(v);
      bench.tick();
    }
  };
  run(Vector3(0.02, 0, 0.05), 1);
  EXPECT_NEAR(bench.out().v_set.norm(), 0.02, 1e-4) << "slides at its own tangential speed";
  EXPECT_STREQ(bench.out().limited_by, "fixture");
  const double depth = bench.set_R().z();
  run(Vector3(0, 0, -0.05), 0.1);
  EXPECT_LT(bench.set_R().z(), depth - 0.001);
  EXPECT_EQ(bench.out().reason, Reason::kNone);
}

TEST_P(EachArm, ARegionThatArrivesAroundAMovingTipBrakesItWithoutAJump) {
  FixtureBench bench(GetParam(), 3);
  const auto hand = [&](double z) {
    bench.servo_cp(Vector3(0, 0, z));
    bench.tick();
  };
  for (int i = 0; i < 200; ++i) hand(0.12 + 0.08 * i * kT);
  bench.forget();
  const double begin = bench.tip_R().z();
  ASSERT_EQ(bench.put(floor_at(0.11)), Reason::kNone) << "a region may come at any time";
  for (int i = 200; i < 500; ++i) hand(0.12 + 0.08 * i * kT);
  EXPECT_LE(bench.hardest, 1 + 1e-9);
  EXPECT_LE(bench.tip_R().z() - begin, GetParam() ? 0.012 : 0.005) << "brakes, goes no deeper";
  const double inside = bench.tip_R().z();
  for (int i = 0; i < 500; ++i) hand(inside);  // the hand comes to the tip and rests
  for (int i = 0; i < 500; ++i) hand(inside);
  EXPECT_NEAR(bench.tip_R().z(), inside, 1e-4) << "the region does not move the tip by itself";
  for (int i = 0; i < 500; ++i) hand(inside - 0.07 * i * kT);
  EXPECT_NEAR(bench.tip_R().z(), inside - 0.07, 2e-3) << "the way out is free";
  for (int i = 0; i < 500; ++i) hand(inside - 0.07 + 0.07 * i * kT);
  EXPECT_LE(bench.tip_R().z(), 0.11 + kArmTolerance) << "and closes behind the tip";
  EXPECT_LE(bench.hardest, 1 + 1e-9);
}

TEST_P(EachArm, CornersOfTwoAndThreeRegionsNeitherChatterNorHoldTheTip) {
  double most = 0;
  for (int run = 0; run < test::family(8, 100); ++run) {
    FixtureBench bench(GetParam(), 50 + run);
    const int n = 2 + run % 2;
    // Planes and hollow spheres whose walls meet about a common edge or corner, as sharp as 20°.
    const double half = bench.random.uniform(10, 70) * M_PI / 180;
    const Vector3 corner(0, 0, 0.13);
    for (int i = 0; i < n; ++i) {
      const double turn = 2 * M_PI * i / n + 0.3;
      const Vector3 in = std::sin(half) * Vector3::UnitZ() +
                         std::cos(half) * Vector3(std::cos(turn), std::sin(turn), 0);
      const bool sphere = bench.random.integer(0, 2) == 0;
      ASSERT_EQ(bench.put(sphere ? fixture(i ? (i > 1 ? "c" : "b") : "a", Shape::kSphere,
                                           Side::kStayIn, corner - 0.08 * in, Vector3::Zero(), 0.08)
                                 : fixture(i ? (i > 1 ? "c" : "b") : "a", Shape::kPlane,
                                           Side::kKeepOut, corner, in, 0)),
                Reason::kNone);
    }
    FixtureBench free(GetParam(), 50 + run);
    double path = 0, free_path = 0;
    Vector3 before = Vector3::Zero(), free_before = before;
    const Vector3 aside(bench.random.uniform(-0.004, 0.004), bench.random.uniform(-0.004, 0.004),
                        0);
    for (int i = 0; i < 2000; ++i) {
      const double press = std::min(1.0, i / 500.0);
      const Vector3 noise(bench.random.normal(), bench.random.normal(), bench.random.normal());
      bench.servo_cp(kStart + press * (Vector3(0, 0, 0.03) + aside) + 5e-5 * noise);
      bench.tick();
      free.servo_cp(kStart + 5e-5 * noise);
      free.tick();
      if (i > 1500) {
        path += (bench.set_R() - before).norm();
        free_path += (free.set_R() - free_before).norm();
      }
      before = bench.set_R();
      free_before = free.set_R();
    }
    EXPECT_LE(path, free_path) << run << ": in a second, with 0.05 mm of noise on the hand";
    most = std::max(most, path / free_path);
    EXPECT_LE(bench.hardest, 1 + 1e-9);
    EXPECT_LE(bench.deepest, kArmTolerance);
    for (int i = 0; i < 1000; ++i) {
      const double back = std::min(1.0, i / 500.0);
      bench.servo_cp(kStart + (1 - back) * (Vector3(0, 0, 0.03) + aside));
      bench.tick();
    }
    EXPECT_LE((bench.tip_R() - kStart).norm(), 5e-4) << run << ": the way out is free";
  }
  std::printf("[   worst  ] motion in a corner %.2f of the same hand's without walls\n", most);
}

TEST_P(EachArm, TheShaftKeepsOutAsTheTipDoes) {
  FixtureBench bench(GetParam(), 4);
  Fixture vessel = fixture("vessel", Shape::kCapsule, Side::kKeepOut, Vector3(0.012, -0.03, 0.07),
                           Vector3(0, 0.06, 0), 0.005);
  vessel.of = Fixture::Of::kShaft;
  ASSERT_EQ(bench.put(vessel), Reason::kNone);
  double farthest = 0;
  for (int i = 0; i < 3000; ++i) {
    const double t = i * kT, x = 0.04 * std::sin(0.5 * M_PI * t);
    bench.servo_cp(Vector3(x, 0.01 * std::sin(M_PI * t), 0.12));
    bench.tick();
    farthest = std::max(farthest, bench.tip_R().x());
  }
  std::printf("[   worst  ] shaft %.0f um inside; tip %.1f mm aside\n", bench.deepest * 1e6,
              farthest * 1e3);
  EXPECT_LE(bench.deepest, kArmTolerance);
  EXPECT_NEAR(farthest, 0.012, 2e-3) << "where the shaft touches, at seven twelfths of the way";
  EXPECT_LE(bench.hardest, 1 + 1e-9);
}

TEST_P(EachArm, AMoveThatARegionBlocksIsRefusedBeforeAnythingMoves) {
  FixtureBench bench(GetParam(), 5);
  const Fixture ball = fixture("ball", Shape::kSphere, Side::kKeepOut, Vector3(0.02, 0, 0.12),
                               Vector3::Zero(), 0.006);
  ASSERT_EQ(bench.put(ball), Reason::kNone);
  for (int i = 0; i < 10; ++i) bench.tick();
  const auto answer = [&](Motion motion, const Vector3& p) {
    bench.pose(motion, p);
    return bench.tick().verdicts[0].reason;
  };
  EXPECT_EQ(answer(Motion::kMoveCp, Vector3(0.02, 0, 0.12)), Reason::kFixture) << "into it";
  EXPECT_EQ(answer(Motion::kMoveCp, Vector3(0.04, 0, 0.12)), Reason::kFixture) << "through it";
  EXPECT_EQ(answer(Motion::kInterpolateCp, Vector3(0.04, 0, 0.12)), Reason::kFixture);
  EXPECT_FALSE(bench.out().busy);
  EXPECT_EQ(answer(Motion::kMoveCp, Vector3(0.02, 0.02, 0.12)), Reason::kNone) << "around it";
  for (int i = 0; i < 1000 && bench.out().busy; ++i) bench.tick();
  EXPECT_EQ(answer(Motion::kMoveCp, Vector3(0.04, 0, 0.12)), Reason::kNone);
  for (int i = 0; i < 100; ++i) bench.tick();
  ASSERT_TRUE(bench.out().busy);
  const Fixture wall =
      fixture("wall", Shape::kPlane, Side::kKeepOut, Vector3(0.035, 0, 0), Vector3::UnitX(), 0);
  ASSERT_EQ(bench.put(wall), Reason::kNone);
  for (int i = 0; i < 500; ++i) bench.tick();
  EXPECT_FALSE(bench.out().busy) << "a region that comes into the way ends the move";
  EXPECT_LE(bench.deepest, kArmTolerance);
  EXPECT_LE(bench.hardest, 1 + 1e-9);
}

TEST(Fixtures, LimitsOnlyTightenWhileTheArmIsEnabled) {
  FixtureBench bench(false, 6);
  Controller& controller = bench.controller();
  Fixture cell = floor_at(0.16);
  cell.set_name("of_cell");
  cell.of_cell = true;
  ASSERT_EQ(bench.put(cell), Reason::kNone);
  ASSERT_EQ(bench.put(floor_at(0.15)), Reason::kNone);
  EXPECT_EQ(bench.put(floor_at(0.16)), Reason::kFixtureWhileEnabled) << "may allow more";
  EXPECT_EQ(controller.remove_fixture("floor"), Reason::kFixtureWhileEnabled);
  EXPECT_EQ(controller.request(StateCommand::kPause), Reason::kNone);
  EXPECT_EQ(bench.put(floor_at(0.16)), Reason::kNone);
  EXPECT_EQ(controller.remove_fixture("floor"), Reason::kNone);
  EXPECT_EQ(controller.remove_fixture("floor"), Reason::kNoFixture);
  cell.of_cell = false;
  EXPECT_EQ(bench.put(cell), Reason::kFixtureOfCell);
  EXPECT_EQ(controller.remove_fixture("of_cell"), Reason::kFixtureOfCell);
  Fixture bad = floor_at(NAN);
  EXPECT_EQ(bench.put(bad), Reason::kNotFinite);
  for (int i = 0; i < Fixtures::kMost - 1; ++i) {
    Fixture more = floor_at(0.16);
    more.set_name("more_" + std::to_string(i));
    EXPECT_EQ(bench.put(more), Reason::kNone);
  }
  EXPECT_EQ(bench.put(floor_at(0.16)), Reason::kFixturesFull);
}

TEST(Fixtures, SixteenRegionsTakeNoMemoryInACycle) {
  FixtureBench bench(false, 7);
  for (int i = 0; i < Fixtures::kMost; ++i) {
    const std::string title = "r" + std::to_string(i);
    bench.put(random_region(bench.random, title.c_str()));
  }
  for (int i = 0; i < 500; ++i) {
    bench.servo_cp(kStart + Vector3(0, 0, 0.02 * std::min(1.0, i / 250.0)));
    bench.tick();
  }
  EXPECT_EQ(bench.out().reason, Reason::kFixture);
  bench.servo_cp(kStart + Vector3(0, 0, 0.02));
  test::HeapWatch watch;
  bench.controller().step(bench.in());
  EXPECT_EQ(watch.calls(), 0);
}

// --- the parts -----------------------------------------------------------------------------------

TEST(Fixtures, DistancesAndDirectionsAgreeWithFormulasOfTheTest) {
  test::Random random(8);
  const int n = test::family(5000, 1000000);
  int edges = 0;
  for (int i = 0; i < n; ++i) {
    Fixture f = random_region(random, "f");
    if (f.side == Side::kKeepOut && random.integer(0, 1) == 1) f.of = Fixture::Of::kShaft;
    if (f.shape == Shape::kPlane) f.of = Fixture::Of::kTip;
    const Vector3 p = kStart + 0.05 * random.uniform(0, 1) * direction(random);
    const Wall wall = wall_at(f, p);
    const double oracle = allowed_by(f, p, Vector3::Zero());
    ASSERT_NEAR(wall.distance, oracle, 1e-7);
    const double h = 1e-6;
    Vector3 gradient;
    double bend = 0;
    for (int k = 0; k < 3; ++k) {
      const Vector3 d = h * Vector3::Unit(k);
      const double up = wall_at(f, p + d).distance, down = wall_at(f, p - d).distance;
      gradient[k] = (up - down) / (2 * h);
      bend = std::max(bend, std::abs(up - 2 * wall.distance + down) / h);
    }
    if (bend > 1e-3) {  // an edge runs between the places: two directions, and neither is wrong
      ++edges;
      continue;
    }
    ASSERT_NEAR((gradient - wall.lever * wall.away).norm(), 0, 2e-3) << i;
  }
  EXPECT_LT(edges, 1 + n / 1000);
  test::report("places", n);
}

TEST(Fixtures, TheNearestPointInHalfSpacesFulfilsItsOptimality) {
  test::Random random(9);
  long active = 0;
  const int n = test::family(20000, 1000000);
  for (int i = 0; i < n; ++i) {
    std::array<Constraint, 6> spaces;
    const int count = random.integer(1, 6);
    for (int k = 0; k < count; ++k) spaces[k] = {direction(random), -random.uniform(0, 0.3)};
    const Vector3 x0 = direction(random);
    Vector3 x;
    ASSERT_TRUE(nearest_in(spaces.data(), count, x0, x));  // the origin is inside
    for (int k = 0; k < count; ++k) {
      ASSERT_GE(spaces[k].n.dot(x), spaces[k].least - 1e-9);
      active += spaces[k].n.dot(x) < spaces[k].least + 1e-9;
    }
    // Nearest in a convex set: no other point of it lies on x0's side of x.
    for (int k = 0; k < 20; ++k) {
      Vector3 y = 0.5 * random.uniform(0, 1) * direction(random);
      for (int s = 0; s < count; ++s) {
        if (spaces[s].n.dot(y) < spaces[s].least) y *= spaces[s].least / spaces[s].n.dot(y);
      }
      ASSERT_LE((x0 - x).dot(y - x), 1e-9) << i;
    }
  }
  test::report("walls that hold", active);
}

}  // namespace
}  // namespace surg
