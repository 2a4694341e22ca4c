// URDF to chain: the same robot as KDL's, or no robot.
#include <gtest/gtest.h>
#include <urdf_parser/urdf_parser.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <kdl/tree.hpp>
#include <kdl_parser/kdl_parser.hpp>
#include <string>

#include "support/small_cell.hpp"
#include "surg_control/files/kdl_check.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {
namespace {

using surg_control_test::SmallCell;

surg::Model load(const SmallCell& cell) {
  const surg::ArmSetup setup = surg::load_arm(cell.cell(), "PSM1");
  return surg::load_model(setup.robot);
}

/// KDL's chain by urdfdom and kdl_parser: a second opinion of the file, too.
KDL::Chain by_other_parsers(const surg::Model& model, const surg::RobotConfig& robot) {
  // KDL knows no inertia of a root link and would warn; kinematics needs none.
  const urdf::ModelInterfaceSharedPtr parsed = urdf::parseURDF(model.urdf);
  parsed->root_link_->inertial.reset();
  KDL::Tree tree;
  KDL::Chain chain;
  EXPECT_TRUE(kdl_parser::treeFromUrdfModel(*parsed, tree));
  EXPECT_TRUE(tree.getChain(robot.base_link, robot.flange_link, chain));
  return chain;
}

TEST(ModelLoader, AgreesWithKdlOnJointsAndFiles) {
  SmallCell cell;
  EXPECT_EQ(load(cell).urdf, cell.read("robot.urdf"));
  const std::string cells = SURG_CELLS;
  for (const std::string& folder : {cell.cell(), cells + "/sim_ur5e", cells + "/sim_panda"}) {
    const surg::ArmSetup setup = surg::load_arm(folder, "");
    const surg::Model& model = setup.model;
    const double joints = difference_to_kdl(model.chain, to_kdl(model.joints), setup.robot);
    const double file =
        difference_to_kdl(model.chain, by_other_parsers(model, setup.robot), setup.robot);
    std::printf("%s: %d joints, largest difference to KDL %.2g, by urdfdom %.2g\n", folder.c_str(),
                model.chain.dof(), joints, file);
    EXPECT_LE(joints, 1e-12);
    EXPECT_LE(file, 1e-12);
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

TEST(ModelLoader, CrossCheckSeesASmallDifference) {
  SmallCell cell;
  const surg::ArmSetup setup = surg::load_arm(cell.cell(), "PSM1");
  const surg::Model model = surg::load_model(setup.robot);
  std::vector<surg::Joint> joints = model.chain.joints();
  joints[3].X_PJ.translation().x() += 1e-8;
  const surg::Chain other(joints, model.chain.X_LF());
  const double difference = difference_to_kdl(other, to_kdl(model.joints), setup.robot);
  EXPECT_GT(difference, 5e-9);
  EXPECT_LT(difference, 1e-6);
}

}  // namespace
}  // namespace surg_control
