// Replay: a recording agrees with itself, and a wrong one is seen.
#include <gtest/gtest.h>

#include <random>
#include <sstream>
#include <string>

#include "support/small_cell.hpp"
#include "surg_control/files/replay.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {
namespace {

/// A recording made with plain vectors: tip from the pose, depth and deviation by projection.
std::string recording(const surg::Chain& chain, const surg::ToolCalibration& tool,
                      double tip_error) {
  std::mt19937 random(3);
  std::ostringstream csv;
  csv.precision(17);
  csv << "stamp_ns,receive_ns,tick,reason,q0,q1,q2,q3,q4,q5,p_tip_x,p_tip_y,p_tip_z,"
         "p_rcm_x,p_rcm_y,p_rcm_z,depth,rcm_error\n";
  csv << "0,0,0,,,,,,,,,,,,,,,\n";  // no joint state yet
  const surg::Vector3 p_rcm(0.5, 0.1, 0.2);
  for (int k = 1; k <= 50; ++k) {
    surg::JointVector q(6);
    for (int i = 0; i < 6; ++i) q[i] = std::uniform_real_distribution<>(-2, 2)(random);
    const surg::Pose X_BF = chain.forward(q);
    const surg::Vector3 tip = X_BF * tool.p_FTip;
    const surg::Vector3 s = X_BF.linear() * tool.s_F;
    const double depth = s.dot(tip - p_rcm);
    const double error = (p_rcm - tip).cross(s).norm();
    csv << k * 2000000 << ",1," << k << ",\"held, because\"";
    for (int i = 0; i < 6; ++i) csv << ',' << q[i];
    csv << ',' << tip.x() + tip_error << ',' << tip.y() << ',' << tip.z() << ',' << p_rcm.x() << ','
        << p_rcm.y() << ',' << p_rcm.z() << ',' << depth << ',' << error << '\n';
  }
  return csv.str();
}

TEST(Replay, AgreesOrTells) {
  surg_control_test::SmallCell cell;
  const surg::ArmSetup setup = surg::load_arm(cell.cell(), "");
  const surg::Chain chain = surg::load_model(setup.robot).chain;
  std::istringstream good(recording(chain, setup.mounted.tool, 0));
  std::ostringstream out;
  const ReplayReport report = replay(good, out, chain, setup.mounted.tool);
  EXPECT_EQ(report.rows, 50U);
  EXPECT_EQ(report.skipped, 1U);
  EXPECT_LE(report.worst(), 1e-12);
  std::istringstream wrong(recording(chain, setup.mounted.tool, 1e-4));
  EXPECT_NEAR(replay(wrong, out, chain, setup.mounted.tool).tip, 1e-4, 1e-9);
}

TEST(Replay, BrokenFilesAreRefused) {
  surg_control_test::SmallCell cell;
  const surg::ArmSetup setup = surg::load_arm(cell.cell(), "");
  const surg::Chain chain = surg::load_model(setup.robot).chain;
  const std::string good = recording(chain, setup.mounted.tool, 0);
  for (const std::string& text :
       {std::string(), std::string("a,b\n1,2\n"), good.substr(0, good.size() / 2), good + "1,2\n",
        good + "1,1,1,x,a,1,1,1,1,1,1,1,1,1,1,1,1,1\n"}) {
    std::istringstream in(text);
    std::ostringstream out;
    EXPECT_THROW(replay(in, out, chain, setup.mounted.tool), ReplayError);
  }
}

}  // namespace
}  // namespace surg_control
