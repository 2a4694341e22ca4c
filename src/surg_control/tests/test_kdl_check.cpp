// URDF to chain: the same robot as KDL's, or no robot.
#include <gtest/gtest.h>
#include <urdf_parser/urdf_parser.h>

#include <cstdio>
#include <kdl/tree.hpp>
#include <kdl_parser/kdl_parser.hpp>
#include <string>
#include <vector>

#include "support/small_cell.hpp"
#include "surg_control/files/kdl_check.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {
namespace {

using surg_control_test::SmallCell;

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

TEST(KdlCheck, AgreesOnJointsAndFiles) {
  SmallCell cell;
  EXPECT_EQ(surg::load_arm(cell.cell(), "PSM1").model.urdf, cell.read("robot.urdf"));
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
    EXPECT_NO_THROW(check_against_kdl(setup.robot));
  }
}

TEST(KdlCheck, SeesASmallDifference) {
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
