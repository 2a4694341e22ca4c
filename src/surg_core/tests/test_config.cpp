// The schema: a good document is taken, every bad one refused with file, key, value and range.
#include <functional>

#include "arm.hpp"
#include "support.hpp"
#include "surg_core/config.hpp"

namespace surg {
namespace {

using test::good_robot;

std::string error_of(const std::function<void()>& run) {
  try {
    run();
  } catch (const ConfigError& error) {
    return error.what();
  }
  return "";
}

TEST(Config, TakesAGoodRobot) {
  const RobotConfig robot = parse_robot(good_robot());
  EXPECT_EQ(robot.joint_names.size(), 6u);
  EXPECT_EQ(robot.limits.cone, 1.0472);
  EXPECT_EQ(robot.tuning.rcm_gain, 20);
}

TEST(Config, EveryKeyIsNeededAndNoneHasADefault) {
  int n = 0;
  for (const auto& item : good_robot().values) {
    Document d = good_robot();
    d.values.erase(item.first);
    const std::string error = error_of([&] { parse_robot(d); });
    EXPECT_NE(error.find(item.first), std::string::npos) << item.first << ": " << error;
    ++n;
  }
  test::report("missing keys", n);
}

TEST(Config, NoNumberMayBeNanInfiniteOrAbsurd) {
  int n = 0;
  for (const auto& item : good_robot().values) {
    if (!std::holds_alternative<double>(item.second)) continue;
    for (const double bad : {double{NAN}, double{INFINITY}, -double{INFINITY}, 1e308, -1.0}) {
      Document d = good_robot();
      d.values[item.first] = bad;
      const std::string error = error_of([&] { parse_robot(d); });
      EXPECT_NE(error.find(item.first), std::string::npos) << item.first << " " << bad;
      EXPECT_NE(error.find("robot.yaml"), std::string::npos);
      ++n;
    }
  }
  test::report("bad numbers", n);
}

TEST(Config, SaysFileLineKeyValueAndRange) {
  Document d = good_robot();
  d.values["limits.cone"] = 9.0;
  EXPECT_EQ(error_of([&] { parse_robot(d); }),
            "robot.yaml:42: limits.cone: 9 rad is out of range; allowed is 0.05 to 1.3 rad");
}

TEST(Config, RefusesUnknownKeysWrongTypesAndWrongSizes) {
  const std::map<std::string, Value> bad = {
      {"limits.tip_velocitty", 0.1},
      {"name", 3.0},
      {"command", std::string("torque")},
      {"joints.home", std::vector<double>(5, 0.1)},
      {"joints.names", std::vector<std::string>{"a", "b"}},
      {"joints.velocity", std::vector<double>{1, 1, 1, 1, 1, NAN}},
      {"joints.position_min", std::vector<double>(6, 6.5)},
      {"limits.depth_slow", 0.015},
      {"limits.rcm_error_warn", 0.002},
  };
  for (const auto& [key, value] : bad) {
    Document d = good_robot();
    d.values[key] = value;
    EXPECT_NE(error_of([&] { parse_robot(d); }), "") << key;
  }
}

TEST(Config, ACellMayOnlyTighten) {
  const Limits limits = parse_robot(good_robot()).limits;
  CellArm arm;
  arm.name = "PSM1";
  arm.limits = {{"tip_velocity", 0.1}, {"depth_min", 0.025}};
  const Limits tight = tighten(limits, arm, "cell.yaml");
  EXPECT_EQ(tight.tip_velocity, 0.1);
  EXPECT_EQ(tight.depth_min, 0.025);
  for (const auto& loose : std::map<std::string, double>{{"tip_velocity", 0.26},
                                                         {"depth_min", 0.019},
                                                         {"cone", 1.2},
                                                         {"stop_deceleration", 3},
                                                         {"joint_margin", 0.05},
                                                         {"tip_velocity", NAN}}) {
    arm.limits = {loose};
    EXPECT_NE(error_of([&] { tighten(limits, arm, "cell.yaml"); }).find(loose.first),
              std::string::npos);
  }
}

TEST(Config, HashSeesEveryLimit) {
  const RobotConfig robot = parse_robot(good_robot());
  const std::string before = limits_hash(robot, robot.limits);
  Limits other = robot.limits;
  other.cone = 1.0;
  EXPECT_NE(before, limits_hash(robot, other));
  RobotConfig faster = robot;
  faster.velocity[3] = 2.9;
  EXPECT_NE(before, limits_hash(faster, robot.limits));
}

}  // namespace
}  // namespace surg
