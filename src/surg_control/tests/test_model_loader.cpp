// URDF to chain: an arm's own kinematics, or no robot.
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <string>

#include "support/small_cell.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {
namespace {

using surg_control_test::SmallCell;

/// The emulated UR5e's cell with kinematics of its own.
void write_own_kinematics(const SmallCell& cell, const std::string& serial, const std::string& d1) {
  const std::string cells = SURG_CELLS, bundled = cells + "/emulated_ur5e/";
  const auto text = [](const std::string& file) {
    std::ifstream stream(file);
    return std::string(std::istreambuf_iterator<char>(stream), {});
  };
  std::string yaml = text(bundled + "cell.yaml");
  for (std::size_t at; (at = yaml.find("../../src")) != std::string::npos;) {
    yaml.replace(at, 9, cells + "/../src");
  }
  cell.write("cell/cell.yaml", yaml);
  for (const std::string file : {"calibration/tool_PSM1.yaml", "calibration/trocar_PSM1.yaml"}) {
    cell.write("cell/" + file, text(bundled + file));
  }
  cell.write("cell/calibration/kinematics_PSM1.yaml",
             "format: surg_kinematics/1\nmodel: ur5e\nserial: \"" + serial +
                 "\"\ndate: \"2026-11-23\"\ntheta: [0, 0, 0, 0, 0, 0]\n"
                 "a: [0, -0.425, -0.3922, 0, 0, 0]\nd: [" +
                 d1 +
                 ", 0, 0, 0.1333, 0.0997, 0.0996]\n"
                 "alpha: [1.5707963267948966, 0, 0, 1.5707963267948966, -1.5707963267948966, 0]\n");
}

TEST(ModelLoader, AnArmsOwnKinematicsAreInTheChain) {
  SmallCell cell;
  write_own_kinematics(cell, "20225500001", "0.1635");  // the drawing has 0.1625
  const surg::ArmSetup setup = surg::load_arm(cell.cell(), "PSM1");
  const surg::Chain drawn = surg::load_model(setup.robot).chain;
  const surg::Chain own = setup.model.chain;
  const surg::JointVector& home = setup.robot.home;
  const surg::Vector3 moved = own.forward(home).translation() - drawn.forward(home).translation();
  EXPECT_NEAR((moved - surg::Vector3(0, 0, 0.001)).norm(), 0, 1e-9);

  const auto expect_error = [&](const std::string& serial, const std::string& d1,
                                const std::string& part) {
    write_own_kinematics(cell, serial, d1);
    try {
      surg::load_arm(cell.cell(), "PSM1");
      ADD_FAILURE() << "accepted; expected '" << part << "'";
    } catch (const surg::ConfigError& error) {
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    }
  };
  expect_error("77", "0.1635", "serial: '77'");
  expect_error("20225500001", "0.19", "another model");
}

}  // namespace
}  // namespace surg_control
