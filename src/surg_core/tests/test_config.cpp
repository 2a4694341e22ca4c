// The schema: a good document is taken, every bad one refused with file, key, value and range.
#include <functional>

#include "support/test_arm.hpp"
#include "support/test_support.hpp"
#include "surg_core/config.hpp"
#include "surg_core/motion/jaw.hpp"

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

TEST(Config, EveryKeyIsNeededAndNoneHasADefault) {
  int n = 0;
  for (const auto& item : good_robot().values) {
    Document d = good_robot();
    d.values.erase(item.first);
    const std::string error = error_of([&] { parse_robot(d); });
    EXPECT_NE(error.find(item.first + ": is missing"), std::string::npos) << error;
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

TEST(Config, AMisspeltKeyIsNamedBesideTheOneThatIsMissing) {
  const std::map<std::string, std::string> misspelt = {
      {"limits.tip_velocity", "limits.tip_velocitty"},
      {"tuning.stream_delay", "tuning.stream_deley"},
      {"joints.home", "joints.hom"},
      {"flange_link", "flang_link"}};
  for (const auto& [right, wrong] : misspelt) {
    Document d = good_robot();
    d.values[wrong] = d.values[right];
    d.values.erase(right);
    const std::string error = error_of([&] { parse_robot(d); });
    EXPECT_EQ(error.find("robot.yaml: " + right + ": is missing; "), 0u) << error;
    EXPECT_NE(error.find(wrong), std::string::npos) << error;
  }
  // Beside the right one it is a key too many.
  Document d = good_robot();
  d.values["limits.tip_velocitty"] = 0.1;
  EXPECT_NE(error_of([&] { parse_robot(d); }).find("limits.tip_velocitty: is not a known key"),
            std::string::npos);
}

TEST(Config, AnErrorAcrossTwoLimitsNamesTheLineOfEach) {
  struct Pair {
    const char *lower, *upper;
    double both;
  };
  for (const Pair& pair : {Pair{"depth_min", "depth_slow", 0.03},
                           {"depth_slow", "depth_max", 0.1},
                           {"rcm_error_warn", "rcm_error_fault", 0.001},
                           {"tip_force_soft", "tip_force_hard", 5},
                           {"trocar_force_warn", "trocar_force_fault", 10}}) {
    Document d = good_robot();
    const std::string low = std::string("limits.") + pair.lower;
    const std::string high = std::string("limits.") + pair.upper;
    d.lines[low] = 31;
    d.lines[high] = 35;
    d.values[low] = d.values[high] = pair.both;
    const std::string error = error_of([&] { parse_robot(d); });
    EXPECT_NE(error.find("robot.yaml:31: " + low), std::string::npos) << error;
    EXPECT_NE(error.find("robot.yaml:35: " + high), std::string::npos) << error;
  }
  // In a cell the line is that of the limit which the cell states.
  const Limits limits = parse_robot(good_robot()).limits;
  CellArm arm;
  arm.name = "PSM1";
  arm.limits = {{"depth_min", 0.03}};
  arm.where = {{"limits.depth_min", "cell.yaml:12"}};
  EXPECT_NE(error_of([&] {
              tighten(limits, arm, "cell.yaml");
            }).find("cell.yaml:12: arms.PSM1.limits.depth_min: depth_min 0.03"),
            std::string::npos);
  arm.limits = {{"depth_min", 0.01}};
  EXPECT_NE(error_of([&] { tighten(limits, arm, "cell.yaml"); }).find("cell.yaml:12: "),
            std::string::npos);
}

Document tool_document(const std::vector<double>& axis, const std::vector<double>& tip) {
  Document d;
  d.file = "tool.yaml";
  d.values = {{"format", std::string("surg_tool/1")},
              {"shaft_axis", axis},
              {"tip", tip},
              {"residual", 0.0},
              {"condition", 1.0},
              {"n", 10.0},
              {"date", std::string("2026-01-01")}};
  return d;
}

TEST(Config, AShaftPointsToItsTipAndIsLongerThanTheDeepestTarget) {
  const Limits limits = parse_robot(good_robot()).limits;  // depth_max 0.22
  const ToolCalibration tool = parse_tool(tool_document({0, 0, 1}, {0.06, 0, 0.3}));
  EXPECT_EQ(error_of([&] { check_tool(tool, limits, "tool.yaml"); }), "");
  for (const std::vector<double>& axis : {std::vector<double>{0, 0, -1}, {0, 1, 0}}) {
    const std::string error = error_of([&] { parse_tool(tool_document(axis, {0.06, 0, 0.3})); });
    EXPECT_NE(error.find("tool.yaml: shaft_axis: points away"), std::string::npos) << error;
  }
  for (const double length : {0.22, 0.1}) {
    const ToolCalibration stub = parse_tool(tool_document({0, 0, 1}, {0.3, 0, length}));
    const std::string error = error_of([&] { check_tool(stub, limits, "tool.yaml"); });
    EXPECT_NE(error.find("tool.yaml: tip: "), std::string::npos) << error;
    EXPECT_NE(error.find("depth_max 0.22"), std::string::npos) << error;
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

Document instrument_document() {
  Document d;
  d.file = "scope.yaml";
  d.values = {{"format", std::string("surg_instrument/1")},
              {"name", std::string("scope")},
              {"urdf", std::string("scope.urdf")},
              {"mount_link", std::string("mount")},
              {"tip_link", std::string("tip")}};
  return d;
}

TEST(Config, AnInstrumentMayLackAJawAndHaveCameras) {
  Document d = instrument_document();
  const InstrumentConfig bare = parse_instrument(d);
  EXPECT_EQ(bare.jaw_min, 0);
  EXPECT_EQ(bare.jaw_max, 0);
  EXPECT_EQ(bare.jaw_velocity, 0);
  EXPECT_TRUE(bare.camera.frames.empty());
  d.values["camera.frames"] = std::vector<std::string>{"left", "right"};
  d.values["camera.fovy"] = 1.0;
  EXPECT_NE(error_of([&] { parse_instrument(d); }).find("camera.baseline: is missing"),
            std::string::npos);
  d.values["camera.baseline"] = 0.004;
  EXPECT_EQ(parse_instrument(d).camera.baseline, 0.004);
  d.values["camera.frames"] = std::vector<std::string>{"left"};
  EXPECT_NE(error_of([&] { parse_instrument(d); }).find("camera.baseline: is not a known key"),
            std::string::npos);
  d.values.erase("camera.baseline");
  EXPECT_EQ(parse_instrument(d).camera.frames.size(), 1u);
  // Part of a jaw is no jaw.
  d.values["jaw.max"] = 1.0;
  EXPECT_NE(error_of([&] { parse_instrument(d); }).find("jaw.min: is missing"), std::string::npos);
}

TEST(Config, AJawThatIsNotThereNeverMoves) {
  Jaw jaw(parse_instrument(instrument_document()), 0.002);
  jaw.sense(0.0);
  jaw.go_to(0.7, true);
  for (int k = 0; k < 500; ++k) {
    jaw.advance(true);
    EXPECT_EQ(jaw.setpoint(), 0);
  }
  EXPECT_FALSE(jaw.busy());
}

TEST(Config, ArmsComeInTheFilesOrderWithTheirOwnHomes) {
  Document d;
  d.file = "cell.yaml";
  d.values = {{"format", std::string("surg_cell/1")},
              {"name", std::string("pair")},
              {"network", std::string("loopback")}};
  int line = 10;
  for (const std::string name : {"PSM1", "ECM", "A"}) {
    const std::string prefix = "arms." + name;
    d.lines[prefix] = line++;
    d.values[prefix + ".robot"] = std::string("robot.yaml");
    d.values[prefix + ".instrument"] = std::string("tool.yaml");
    d.values[prefix + ".link"] = std::string("simulator");
    d.values[prefix + ".base.xyz"] = std::vector<double>{0, 0, 0};
    d.values[prefix + ".base.rpy"] = std::vector<double>{0, 0, 0};
  }
  d.values["arms.ECM.home"] = std::vector<double>{0.1, 0.2, 0.3, 0.4, 0.5, 0.6};
  const CellConfig cell = parse_cell(d);
  ASSERT_EQ(cell.arms.size(), 3u);
  EXPECT_EQ(cell.arms[0].name, "PSM1");
  EXPECT_EQ(cell.arms[1].name, "ECM");
  EXPECT_EQ(cell.arms[2].name, "A");
  const RobotConfig robot = parse_robot(good_robot());
  EXPECT_EQ(with_home(robot, cell.arms[0], cell.file).home, robot.home);
  EXPECT_EQ(with_home(robot, cell.arms[1], cell.file).home[5], 0.6);
  CellArm wrong = cell.arms[1];
  wrong.home.pop_back();
  EXPECT_NE(error_of([&] {
              with_home(robot, wrong, cell.file);
            }).find("cell.yaml: arms.ECM.home: has 5 values"),
            std::string::npos);
  wrong = cell.arms[1];
  for (const double bad : {100.0, -100.0, double{NAN}}) {
    wrong.home[2] = bad;
    EXPECT_NE(error_of([&] { with_home(robot, wrong, cell.file); }).find("is outside its limits"),
              std::string::npos);
  }
}

Document good_link() {
  Document d;
  d.file = "bench.yaml";
  d.values = {{"format", std::string("surg_link/1")},
              {"name", std::string("bench")},
              {"link_timeout", 0.04},
              {"link_lag", 0.0085},
              {"acceleration", 0.95}};
  return d;
}

TEST(Config, ALinkHasItsOwnParametersAndTheRobotHasNoneOfThem) {
  const RobotConfig robot = parse_robot(good_robot());
  EXPECT_EQ(robot.tuning.link_timeout, simulator_link().link_timeout);
  EXPECT_EQ(robot.tuning.link_lag, 0.012);
  const RobotConfig driven = with_link(robot, parse_link(good_link()));
  EXPECT_EQ(driven.tuning.link_timeout, 0.04);
  EXPECT_EQ(driven.tuning.link_lag, 0.0085);
  EXPECT_EQ(driven.acceleration[0], 0.95 * robot.acceleration[0]);
  EXPECT_EQ(with_link(robot, simulator_link()).acceleration, robot.acceleration);
  EXPECT_NE(limits_hash(driven, driven.limits), limits_hash(robot, robot.limits));
  for (const auto& [key, bad] : std::map<std::string, double>{
           {"link_timeout", 0.02}, {"link_lag", -0.1}, {"acceleration", 1.1}}) {
    Document d = good_link();
    d.values[key] = bad;
    EXPECT_NE(error_of([&] { parse_link(d); }).find(key + ": "), std::string::npos) << key;
    d.values.erase(key);
    EXPECT_NE(error_of([&] { parse_link(d); }).find("missing"), std::string::npos) << key;
  }
  Document old = good_robot();
  old.values["tuning.link_lag"] = 0.012;
  EXPECT_NE(error_of([&] { parse_robot(old); }).find("belongs to the robot's link"),
            std::string::npos);
}

TEST(Config, ALinkStatesOneLagOrOnePerJoint) {
  const RobotConfig robot = parse_robot(good_robot());
  const RobotConfig alike = with_link(robot, parse_link(good_link()));
  EXPECT_EQ(alike.joint_lag.size(), 0);
  Document d = good_link();
  d.values["link_lag"] = std::vector<double>{0.008, 0.009, 0.0085, 0.0101, 0.011, 0.0097};
  const LinkConfig link = parse_link(d);
  const RobotConfig each = with_link(robot, link);
  EXPECT_EQ(each.tuning.link_lag, 0.011) << "of the slowest joint";
  EXPECT_EQ(each.joint_lag[3], 0.0101);
  RobotConfig other = each;
  other.joint_lag[3] += 1e-4;
  EXPECT_NE(limits_hash(each, each.limits), limits_hash(other, other.limits));

  RobotConfig seven = robot;
  seven.name = "panda";
  seven.joint_names.push_back("g");
  CellArm simulated;
  simulated.name = "PSM1";
  simulated.link = kSimulator;
  const auto check = [&](const RobotConfig& driven) {
    check_hardware(simulated, driven, {}, {}, {}, "cell.yaml", "2026-11-23");
  };
  EXPECT_EQ(error_of([&] {
              check(with_link(seven, link));
            }).find("cell.yaml: arms.PSM1.link: link_lag has 6 values; panda has 7"),
            0U);
  EXPECT_NO_THROW(check(each));
  for (const auto& [bad, part] :
       std::map<std::string, std::vector<double>>{{"value 2, 0.06 s", {0.01, 0.06}},
                                                  {"value 1, -0.001 s", {-0.001, 0.01}},
                                                  {"has 0 values", {}},
                                                  {"has 9 values", std::vector<double>(9, 0.01)}}) {
    d.values["link_lag"] = part;
    EXPECT_NE(error_of([&] { parse_link(d); }).find(bad), std::string::npos) << bad;
  }

  CellArm arm;
  arm.name = "PSM1";
  arm.hardware.emplace();
  EXPECT_EQ(with_measured_lag(link, arm).joint_lag, link.joint_lag) << "not stated by the cell";
  arm.hardware->link_lag = 0.012;
  EXPECT_EQ(with_measured_lag(link, arm).joint_lag.size(), 0) << "the cell's number is for all";
  arm.hardware->joint_lag = JointVector::Constant(6, 0.007);
  EXPECT_EQ(with_measured_lag(link, arm).joint_lag, arm.hardware->joint_lag);
}

TEST(Config, ALinkIsANameOrAPath) {
  CellArm arm;
  arm.name = "PSM1";
  arm.robot = "../robots/ur5e.yaml";
  arm.link = "bench";
  EXPECT_EQ(link_file(arm), "../robots/../links/bench.yaml");
  arm.link = "links/mine.yaml";
  EXPECT_EQ(link_file(arm), "links/mine.yaml");
  const std::string error = unknown_link(arm, "cell.yaml", "/tried/mine.yaml");
  for (const char* part :
       {"arms.PSM1.link", "'links/mine.yaml'", "/tried/mine.yaml", "simulator"}) {
    EXPECT_NE(error.find(part), std::string::npos) << part;
  }
}

TEST(Config, ElbowNeedsSevenJoints) {
  const RobotConfig six = parse_robot(good_robot());
  CellArm arm;
  arm.name = "PSM1";
  arm.where["elbow"] = "cell.yaml:7";
  EXPECT_TRUE(std::isnan(with_home(six, arm, "cell.yaml").elbow));
  arm.elbow = 0.4;
  EXPECT_NE(error_of([&] { with_home(six, arm, "cell.yaml"); }).find("arms.PSM1.elbow: ur5e has 6"),
            std::string::npos);
  RobotConfig seven = six;
  seven.joint_names.push_back("g");
  EXPECT_EQ(with_home(seven, arm, "cell.yaml").elbow, 0.4);
  EXPECT_NE(limits_hash(seven, seven.limits),
            limits_hash(with_home(seven, arm, "cell.yaml"), seven.limits));
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
  RobotConfig elsewhere = robot;  // seven joints are pulled there
  elsewhere.home[0] += 1e-9;
  EXPECT_NE(before, limits_hash(elsewhere, robot.limits));
  RobotConfig later = robot;
  later.tuning.stream_delay += 1e-3;
  EXPECT_NE(before, limits_hash(later, robot.limits));
  RobotConfig weaker = robot;
  weaker.tuning.braking_least *= 0.5;
  EXPECT_NE(before, limits_hash(weaker, robot.limits));
  RobotConfig harder = robot;
  harder.tuning.braking_most *= 2;
  EXPECT_NE(before, limits_hash(harder, robot.limits));
}

}  // namespace
}  // namespace surg
