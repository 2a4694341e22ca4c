// URDF to chain: the same robot as KDL's, or no robot.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <string>

#include "support/small_cell.hpp"
#include "surg_control/files/config_loader.hpp"
#include "surg_control/files/model_loader.hpp"

namespace surg_control {
namespace {

using surg_control_test::SmallCell;

Model load(const SmallCell& cell) {
  const ArmSetup setup = load_arm(cell.cell(), "PSM1");
  return load_model(setup.robot, setup.robot_urdf);
}

void expect_refused(const SmallCell& cell, const std::string& part) {
  try {
    load(cell);
    ADD_FAILURE() << "accepted; expected a refusal with '" << part << "'";
  } catch (const surg::ConfigError& error) {
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
  }
}

TEST(ModelLoader, AgreesWithKdl) {
  SmallCell cell;
  const Model model = load(cell);
  EXPECT_EQ(model.chain.dof(), 6);
  EXPECT_LE(model.kdl_error, 1e-12);
  EXPECT_EQ(model.urdf, cell.read("robot.urdf"));
}

TEST(ModelLoader, BundledRobotsAgreeWithKdl) {
  for (const std::string name : {"sim_ur5e", "sim_panda"}) {
    const ArmSetup setup = load_arm(std::string(SURG_CELLS) + "/" + name, "");
    const Model model = load_model(setup.robot, setup.robot_urdf);
    std::printf("%s: %d joints, largest difference to KDL %.2g\n", name.c_str(), model.chain.dof(),
                model.kdl_error);
    EXPECT_LE(model.kdl_error, 1e-12);
  }
}

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
  const ArmSetup setup = load_arm(cell.cell(), "PSM1");
  const surg::Chain drawn = load_model(setup.robot, setup.robot_urdf).chain;
  const surg::Chain own = load_model(setup).chain;
  const surg::JointVector& home = setup.robot.home;
  const surg::Vector3 moved = own.forward(home).translation() - drawn.forward(home).translation();
  EXPECT_NEAR((moved - surg::Vector3(0, 0, 0.001)).norm(), 0, 1e-9);

  const auto expect_error = [&](const std::string& serial, const std::string& d1,
                                const std::string& part) {
    write_own_kinematics(cell, serial, d1);
    try {
      load_model(load_arm(cell.cell(), "PSM1"));
      ADD_FAILURE() << "accepted; expected '" << part << "'";
    } catch (const surg::ConfigError& error) {
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    }
  };
  expect_error("77", "0.1635", "serial: '77'");
  expect_error("20225500001", "0.19", "another model");
}

TEST(ModelLoader, CrossCheckSeesASmallDifference) {
  SmallCell cell;
  const ArmSetup setup = load_arm(cell.cell(), "PSM1");
  const Model model = load_model(setup.robot, setup.robot_urdf);
  std::vector<surg::Joint> joints = model.chain.joints();
  joints[3].X_PJ.translation().x() += 1e-8;
  const surg::Chain other(joints, model.chain.X_LF());
  const double difference = difference_to_kdl(other, setup.robot, model.urdf, 100);
  EXPECT_GT(difference, 5e-9);
  EXPECT_LT(difference, 1e-6);
}

TEST(ModelLoader, RefusesWhatDoesNotFit) {
  const auto changed = [](const char* file, const char* old_text, const char* new_text,
                          const char* part) {
    SmallCell cell;
    cell.replace(file, old_text, new_text);
    expect_refused(cell, part);
  };
  changed("robot.yaml", "[j1, j2,", "[j2, j1,", "joints.names");
  changed("robot.yaml", "flange_link: flange", "flange_link: flansch", "has no link 'flansch'");
  changed("robot.yaml", "base_link: base_link", "base_link: flange", "from 'flange' to");
  changed("robot.yaml", "position_max: [2,", "position_max: [3.0001,", "joints.position_max");
  changed("robot.yaml", "position_min: [-2,", "position_min: [-3.1,", "joints.position_min");
  changed("robot.yaml", "velocity: [1,", "velocity: [2.0001,", "joints.velocity");
  changed("robot.yaml", "urdf: robot.urdf", "urdf: none.urdf", "no such URDF");
  changed("robot.urdf", "type=\"revolute\"", "type=\"prismatic\"", "not revolute");
  changed("robot.urdf", "<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>", "no axis");
  changed("robot.urdf", "</robot>", "", "is no usable URDF");
}

}  // namespace
}  // namespace surg_control
