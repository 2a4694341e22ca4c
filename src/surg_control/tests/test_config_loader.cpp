// F15: a broken, missing or out-of-range file ends in one text with file, line, key and what is
// allowed.
#include <gtest/gtest.h>

#include <filesystem>
#include <random>
#include <string>
#include <vector>

#include "support/small_cell.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {
namespace {

using surg_control_test::SmallCell;

std::string error_of(const SmallCell& cell, const std::string& arm = "PSM1") {
  try {
    surg::load_arm(cell.cell(), arm);
  } catch (const surg::ConfigError& error) {
    return error.what();
  }
  return "";
}

void expect_parts(const std::string& text, const std::vector<std::string>& parts) {
  for (const std::string& part : parts) {
    EXPECT_NE(text.find(part), std::string::npos) << "'" << part << "' missing in: " << text;
  }
}

TEST(ConfigLoader, ToolIsReadWithTheChecksOfAStart) {
  SmallCell cell;
  const surg::ArmSetup setup = surg::load_arm(cell.cell(), "PSM1");
  const auto error = [&](const std::string& words) -> std::string {
    try {
      surg::load_tool(setup, words);
    } catch (const surg::ConfigError& refused) {
      return refused.what();
    }
    return "";
  };
  EXPECT_EQ(surg::load_tool(setup, "").tool.p_FTip, setup.mounted.tool.p_FTip);
  cell.write("cell/next.yaml",
             "format: surg_tool/1\nshaft_axis: [0, 0, 1]\ntip: [0.05, 0, 0.31]\nresidual: 0\n"
             "n: 1\ncondition: 1\ndate: \"2026-01-01\"\n");
  const surg::MountedTool next = surg::load_tool(setup, setup.arm.instrument + " next.yaml");
  EXPECT_EQ(next.tool.p_FTip.z(), 0.31);
  EXPECT_EQ(next.calibration_file, "next.yaml");
  cell.write("cell/short.yaml",
             "format: surg_tool/1\nshaft_axis: [0, 0, 1]\ntip: [0.05, 0, 0.1]\nresidual: 0\n"
             "n: 1\ncondition: 1\ndate: \"2026-01-01\"\n");
  expect_parts(error(setup.arm.instrument + " short.yaml"), {"short.yaml", "tip", "depth_max"});
  cell.write("cell/bad.yaml",
             "format: surg_tool/1\nshaft_axis: [0, 0, 2]\ntip: [0.05, 0, 0.3]\nresidual: 0\n"
             "n: 1\ncondition: 1\ndate: \"2026-01-01\"\n");
  expect_parts(error(setup.arm.instrument + " bad.yaml"), {"bad.yaml:2", "shaft_axis"});
  expect_parts(error(setup.arm.instrument + " gone.yaml"), {"gone.yaml"});
  expect_parts(error("other.yaml"), {"other.yaml", "calibration file", "second word"});
  expect_parts(error("a b c"), {"more than two words"});
}

/// A small cell with a second arm, PSM2, whose base was measured.
void add_measured_arm(const SmallCell& cell) {
  cell.write("cell/cell.yaml",
             cell.read("cell/cell.yaml") +
                 "  PSM2:\n    robot: ../robot.yaml\n    instrument: ../instrument.yaml\n"
                 "    link: simulator\n    base: {xyz: [1, 0, 0], rpy: [0, 0, 0]}\n");
  for (const std::string kind : {"tool", "trocar"}) {
    const std::string folder = "cell/calibration/" + kind;
    cell.write(folder + "_PSM2.yaml", cell.read(folder + "_PSM1.yaml"));
  }
  std::string covariance = "[";
  for (int i = 0; i < 36; ++i) covariance += i % 7 == 0 ? "1e-6, " : "0, ";
  cell.write("cell/calibration/base_PSM2.yaml",
             "format: surg_base/1\nposition: [1.005, 0, 0]\nquaternion: [0, 0, 0.6, 0.8]\n"
             "covariance: " +
                 covariance +
                 "]\nmethod: touch\nresidual: 0.0002\nn: 8\n"
                 "condition: 2.5\ndate: \"2026-11-23\"\nsource: simulated\nreference: PSM1\n"
                 "reference_xyz: [0.1, 0.2, 0.3]\nreference_rpy: [0, 0, 1.5707963267948966]\n"
                 "camera_sha256: none\n");
}

TEST(ConfigLoader, AMeasuredBaseReplacesTheStatedOne) {
  SmallCell cell;
  const surg::Pose stated = surg::load_arm(cell.cell(), "").X_WB;
  add_measured_arm(cell);
  EXPECT_TRUE(surg::load_arm(cell.cell(), "PSM1").X_WB.isApprox(stated, 0));
  const surg::Pose X_WB = surg::load_arm(cell.cell(), "PSM2").X_WB;
  EXPECT_EQ(X_WB.translation(), surg::Vector3(1.005, 0, 0));
  EXPECT_TRUE((X_WB.linear() * surg::Vector3::UnitX()).isApprox(surg::Vector3(0.28, 0.96, 0)));
  std::filesystem::remove(cell.path("cell/calibration/base_PSM2.yaml"));
  EXPECT_EQ(surg::load_arm(cell.cell(), "PSM2").X_WB.translation(), surg::Vector3(1, 0, 0));
}

TEST(ConfigLoader, ABaseThatWasNotMeasuredInThisCellIsRefused) {
  const std::string file = "cell/calibration/base_PSM2.yaml";
  struct Case {
    std::string file, old_text, new_text;
    std::vector<std::string> parts;
  };
  for (const Case& one : std::vector<Case>{
           {file, "reference: PSM1", "reference: PSM3", {"base_PSM2.yaml", "'PSM1'", "repeat"}},
           {"cell/cell.yaml", "[0.1, 0.2, 0.3]", "[0.1, 0.2, 0.31]", {"differ", "0.01", "repeat"}},
           {file, "0.6, 0.8", "0.6, 0.9", {"base_PSM2.yaml:3", "quaternion", "length"}},
           {file, "[1e-6, ", "[-1e-6, ", {"covariance", "variance"}},
           {file, "[1e-6, ", "[.nan, ", {"covariance", "nan"}},
           {file, "[1e-6, 0, ", "[1e-6, 1e-7, ", {"covariance", "symmetric"}},
           {file, "none", "abc", {"camera_sha256", "64 hexadecimal"}},
           {file, "2026-11-23", "yesterday", {"date", "yesterday"}},
           {file, "n: 8", "n: 8.5", {"n: ", "whole"}},
           {file, "method: touch", "method: eye", {"method", "touch"}}}) {
    SmallCell cell;
    add_measured_arm(cell);
    cell.replace(one.file, one.old_text, one.new_text);
    const std::string error = error_of(cell, "PSM2");
    ASSERT_NE(error, "") << one.new_text << " was accepted";
    expect_parts(error, one.parts);
  }
  SmallCell cell;
  add_measured_arm(cell);
  cell.write("cell/calibration/base_PSM1.yaml", cell.read(file));
  expect_parts(error_of(cell, "PSM1"), {"base_PSM1.yaml", "first arm", "delete"});
}

TEST(ConfigLoader, NeverCrashesOnBrokenBytes) {
  // Mutated and truncated files: accepted or refused by ConfigError, nothing else.
  const int count = std::getenv("SURG_TEST_FULL") != nullptr ? 20000 : 300;
  std::mt19937 random(7);
  SmallCell cell;
  const std::string good = cell.read("robot.yaml");
  int refused = 0;
  for (int i = 0; i < count; ++i) {
    std::string text = good;
    for (unsigned k = 0; k <= random() % 3 && !text.empty(); ++k) {
      const std::size_t at = random() % text.size();
      switch (random() % 4) {
        case 0:
          text[at] = static_cast<char>(random() % 256);
          break;
        case 1:
          text.erase(at, random() % 20);
          break;
        case 2:
          text.insert(at, 1, "{}[]:&*!|>'\"\t-#%@`\n"[random() % 19]);
          break;
        default:
          text.resize(std::max<std::size_t>(at, 1));
      }
    }
    cell.write("robot.yaml", text);
    if (!error_of(cell).empty()) ++refused;
  }
  std::printf("%d mutated files, %d refused\n", count, refused);
  EXPECT_GT(refused, count / 3);
  EXPECT_LT(refused, count);
}

}  // namespace
}  // namespace surg_control
