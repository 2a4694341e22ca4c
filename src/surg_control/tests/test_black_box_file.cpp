// Black boxes on disk: what was written comes back and runs again; nothing half-written is left.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "support/small_cell.hpp"
#include "surg_control/files/black_box_file.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {
namespace {

namespace fs = std::filesystem;

/// A short incident of the small cell's arm.
surg::BlackBoxRecording incident(const surg_control_test::SmallCell& cell) {
  const surg::ArmSetup setup = surg::load_arm(cell.cell(), "");
  const surg::ControllerSetup made{surg::load_model(setup.robot).chain,
                                   setup.robot,
                                   setup.limits,
                                   setup.mounted.instrument,
                                   setup.mounted.tool,
                                   {}};
  surg::Controller controller(made.chain, made.robot, made.limits, made.instrument, made.tool,
                              made.options);
  surg::BlackBox box(controller, made);
  surg::Inputs in;
  in.state_valid = true;
  in.q = setup.robot.home;
  in.qd = surg::JointVector::Zero(made.chain.dof());
  const surg::Pose X_BF = made.chain.forward(in.q);
  box.set_rcm(X_BF * made.tool.p_FTip - 0.1 * (X_BF.linear() * made.tool.s_F));
  box.step(in);
  EXPECT_EQ(box.request(surg::StateCommand::kHome), surg::Reason::kNone);
  EXPECT_EQ(box.request(surg::StateCommand::kEnable), surg::Reason::kNone);
  for (int k = 0; k < 300; ++k) in.q += made.options.dt * box.step(in).qd_command;
  in.q[0] = std::nan("");
  while (!box.frozen()) box.step(in);
  return box.recording({"PSM1", cell.cell(), "2026-01-01T00:00:00Z", "0.1.0"});
}

TEST(BlackBoxFile, ComesBackWholeAndRunsAgain) {
  const surg_control_test::SmallCell cell;
  const surg::BlackBoxRecording written = incident(cell);
  const fs::path folder = fs::path(testing::TempDir()) / "black_box_file";
  fs::create_directories(folder);
  const std::string path = (folder / "a.blackbox").string();
  write_black_box(path, written);
  write_black_box(path, written);  // over an older one
  EXPECT_EQ(std::distance(fs::directory_iterator(folder), fs::directory_iterator()), 1);
  const surg::BlackBoxRecording read = read_black_box(path);
  EXPECT_EQ(read.label.cell, cell.cell());
  EXPECT_EQ(read.steps.size(), written.steps.size());
  EXPECT_EQ(read.steps.back().out.reason, surg::Reason::kStateNotFinite);
  EXPECT_FALSE(surg::replay(read));
  fs::remove_all(folder);
}

TEST(BlackBoxFile, SaysWhatIsWrong) {
  const surg_control_test::SmallCell cell;
  const surg::BlackBoxRecording recording = incident(cell);
  const auto told = [](auto&& act) -> std::string {
    try {
      act();
    } catch (const surg::BlackBoxError& error) {
      return error.what();
    }
    return "";
  };
  const std::string nowhere = "/nonexistent/a.blackbox";
  EXPECT_NE(told([&] { write_black_box(nowhere, recording); }).find(nowhere), std::string::npos);
  EXPECT_NE(told([&] { read_black_box(nowhere); }).find("No such file"), std::string::npos);
  EXPECT_NE(told([&] { write_black_box("/dev/full/x", recording); }), "");
  const std::string path = (fs::path(testing::TempDir()) / "b.blackbox").string();
  write_black_box(path, recording);
  fs::resize_file(path, fs::file_size(path) / 2);
  const std::string half = told([&] { read_black_box(path); });
  EXPECT_NE(half.find(path), std::string::npos);
  EXPECT_NE(half.find("length"), std::string::npos);
  fs::remove(path);
}

}  // namespace
}  // namespace surg_control
