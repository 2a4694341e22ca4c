// Another instrument without a restart: only DISABLED and at rest; what survives it, and what not.
#include "support/controller_bench.hpp"
#include "support/test_support.hpp"
#include "surg_core/state/black_box.hpp"

namespace surg {
namespace {

using namespace test;

InstrumentConfig other_instrument() { return {"", "hook", "", "", "", -0.2, 0.4, 1.0}; }

/// 8 mm longer and 2 mm aside, its shaft leaning by 0.5 degrees.
ToolCalibration other_tool() {
  ToolCalibration tool = offset_tool();
  tool.p_FTip += Vector3(0.002, 0, 0.008);
  tool.s_F = Vector3(0.0087, 0, 1).normalized();
  return tool;
}

Vector3 tip_of(const Bench& bench, const ToolCalibration& tool, const JointVector& q) {
  return bench.chain().forward(q) * tool.p_FTip;
}

TEST(ToolChange, RefusedUnlessDisabledAndAtRest) {
  Bench bench;
  const InstrumentConfig instrument = other_instrument();
  const ToolCalibration tool = other_tool();
  Controller& controller = bench.controller();
  const auto change = [&] { return controller.change_tool(instrument, tool); };
  EXPECT_EQ(change(), Reason::kToolWhileEnabled);
  controller.request(StateCommand::kPause);
  EXPECT_EQ(change(), Reason::kToolWhileEnabled);
  controller.fault(Reason::kForce);
  EXPECT_EQ(change(), Reason::kToolWhileEnabled);
  controller.request(StateCommand::kEnable);
  for (int i = 0; i < 200; ++i) {
    bench.ask(test::command(Motion::kServoCv, Vector3(0.1, 0, 0)));
  }
  controller.request(StateCommand::kDisable);
  EXPECT_EQ(change(), Reason::kNotAtRest);
  EXPECT_TRUE(bench.tick().homed) << "a refused change leaves everything as it was";
  // The old tool is still the one that counts.
  EXPECT_LT((bench.out().p_BTip - tip_of(bench, offset_tool(), bench.in().q)).norm(), 1e-3);
  for (int i = 0; i < 300; ++i) bench.tick();
  HeapWatch watch;
  EXPECT_EQ(change(), Reason::kNone);
  EXPECT_EQ(watch.calls(), 0);
  EXPECT_FALSE(bench.tick().homed);
}

TEST(ToolChange, NewToolIsTheOneThatMovesOnThePivot) {
  Bench bench;
  Controller& controller = bench.controller();
  const InstrumentConfig instrument = other_instrument();
  const ToolCalibration tool = other_tool();
  const Vector3 p_BRcm = bench.out().p_BRcm;
  controller.request(StateCommand::kDisable);
  for (int i = 0; i < 100; ++i) bench.tick();
  ASSERT_EQ(controller.change_tool(instrument, tool), Reason::kNone);
  bench.in().jaw = 0.3;
  bench.tick();
  EXPECT_EQ(bench.out().p_BRcm, p_BRcm) << "the trocar point survives";
  EXPECT_LT((bench.out().p_BTip - tip_of(bench, tool, bench.in().q)).norm(), 1e-12);
  // The shaft leans beside the old trocar point, so that is taught anew.
  EXPECT_GT(bench.out().rcm_error, 5e-4);
  const Pose X_BF = bench.chain().forward(bench.in().q);
  const Vector3 s = X_BF.linear() * tool.s_F;
  ASSERT_EQ(controller.set_rcm(X_BF * tool.p_FTip - 0.12 * s), Reason::kNone);
  bench.tick();
  ASSERT_EQ(controller.request(StateCommand::kEnable), Reason::kNone);
  EXPECT_EQ(bench.tick().qd_command.norm(), 0) << "not before home";
  ASSERT_EQ(controller.request(StateCommand::kHome), Reason::kNone);
  const Vector3 trocar = bench.out().p_BRcm;
  bench.send(test::joints(Motion::kMoveJp, Vector4(0.2, -0.15, 0.13, 0.5)));
  MotionCommand jaw = test::command(Motion::kJawMoveJp);
  jaw.jaw = 2.0;
  bench.send(jaw);
  double worst = 0;
  for (int i = 0; i < 2000; ++i) {
    bench.tick();
    bench.in().jaw = bench.out().jaw_set;
    const Pose X = bench.chain().forward(bench.in().q);
    const Vector3 axis = X.linear() * tool.s_F;
    worst = std::max(worst, axis.cross(Vector3(trocar - X * tool.p_FTip)).norm());
  }
  std::printf("pivot of the new tool %.2e um\n", 1e6 * worst);
  EXPECT_LT(worst, 1e-11);
  EXPECT_NEAR(bench.out().virtual_q[0], 0.2, 1e-3);
  EXPECT_NEAR(bench.out().virtual_q[2], 0.13, 1e-3);
  EXPECT_EQ(bench.out().jaw_set, 0.4) << "the new jaw's range";
}

TEST(ToolChange, OldWayBackAndTargetsAreGone) {
  Bench bench;
  Controller& controller = bench.controller();
  bench.send(test::joints(Motion::kMoveJp, Vector4(0.1, 0, 0.12, 0)));
  for (int i = 0; i < 1500; ++i) bench.tick();
  controller.request(StateCommand::kDisable);
  for (int i = 0; i < 100; ++i) bench.tick();
  const InstrumentConfig instrument = other_instrument();
  const ToolCalibration tool = offset_tool();
  ASSERT_EQ(controller.change_tool(instrument, tool), Reason::kNone);
  bench.tick();
  ASSERT_EQ(controller.request(StateCommand::kEnable), Reason::kNone);
  ASSERT_EQ(controller.request(StateCommand::kHome), Reason::kNone);
  const JointVector q = bench.in().q;
  bench.send(test::command(Motion::kRetrace));
  bool no_trace = false;
  for (int i = 0; i < 500; ++i) no_trace = bench.tick().reason == Reason::kNoTrace || no_trace;
  EXPECT_TRUE(no_trace);
  EXPECT_LT((bench.in().q - q).cwiseAbs().maxCoeff(), 1e-3);
}

/// Distance of a point to the shaft of a tool [m], by hand.
double to_shaft(Bench& bench, const ToolCalibration& tool, double length, const Vector3& p) {
  const Pose X_BF = bench.chain().forward(bench.in().q);
  const Vector3 tip = X_BF * tool.p_FTip, s = X_BF.linear() * tool.s_F;
  const double along = std::clamp((p - tip).dot(s), -length, 0.0);
  return (p - tip - along * s).norm();
}

TEST(ToolChange, ClearanceGuardKnowsTheNewShaftAndItsInstrument) {
  RobotConfig robot = Bench::robot_with_lag(0);
  robot.capsules = {{"forearm", 2, {{0, 0, 0}, {-0.39, 0, 0}, 0.06}, false}};
  InstrumentConfig first = instrument(), next = other_instrument();
  first.capsules = {{"shaft", -1, {{0, 0, 0}, {0, 0, 0.3}, 0.004}, true},
                    {"motor", -1, {{0, 0, 0}, {0, 0, 0.05}, 0.03}, false}};
  next.capsules = {{"shaft", -1, {{0, 0, 0}, {0, 0, 0.3}, 0.003}, true}};
  ToolCalibration longer = offset_tool();
  longer.p_FTip += 0.05 * longer.s_F;
  ClearanceSetup setup;
  setup.distance = 0.02;
  setup.own = arm_shape("arm", ur5e_chain(), Pose::Identity(), robot, first, offset_tool());
  Vector3 p_BBall;
  {
    Bench bench;
    p_BBall = tip_of(bench, offset_tool(), bench.in().q) + Vector3(0.06, 0.02, -0.05);
  }
  ArmShape ball{"other", ur5e_chain(), Pose::Identity(), {}};
  ball.capsules = {{"ball", -1, {p_BBall, p_BBall, 0.01}, false}};
  setup.others = {ball};
  Bench bench({}, 0, 0, 0, &robot, setup);
  Inputs& in = bench.in();
  in.others[0] = {true, 0, JointVector::Zero(6), JointVector::Zero(6)};
  bench.tick();
  const double before = to_shaft(bench, offset_tool(), 0.3, p_BBall) - 0.014;
  EXPECT_NEAR(bench.out().clearance, before, 1e-12);
  bench.controller().request(StateCommand::kDisable);
  for (int i = 0; i < 100; ++i) bench.tick();
  ASSERT_EQ(bench.controller().change_tool(next, longer), Reason::kNone);
  bench.tick();
  const double after = to_shaft(bench, longer, 0.3, p_BBall) - 0.013;
  std::printf("to the shaft %.4f m, to the longer one %.4f m\n", before, after);
  ASSERT_GT(std::abs(after - before), 0.005);
  EXPECT_NEAR(bench.out().clearance, after, 1e-12);
}

TEST(ToolChange, BlackBoxReplaysWithTheToolThatWasMounted) {
  const RobotConfig robot = parse_robot(good_robot());
  const ControllerSetup setup{ur5e_chain(), robot, robot.limits, instrument(), offset_tool(), {}};
  Controller controller(setup.chain, robot, robot.limits, setup.instrument, setup.tool, {});
  BlackBox box(controller, setup);
  const InstrumentConfig next = other_instrument();
  const ToolCalibration tool = other_tool();
  Inputs in;
  in.state_valid = true;
  in.q = robot.home;
  in.qd = JointVector::Zero(6);
  for (int i = 0; i < 50; ++i) box.step(in);
  ASSERT_EQ(box.change_tool(next, tool), Reason::kNone);
  for (int i = 0; i < 50; ++i) box.step(in);
  const BlackBoxRecording recording = box.recording({});
  EXPECT_EQ(recording.steps.size(), 50U);
  EXPECT_EQ(recording.setup.instrument.name, "hook");
  EXPECT_EQ(recording.setup.tool.p_FTip, tool.p_FTip);
  EXPECT_FALSE(replay(decode(encode(recording))));
  box.trigger();
  EXPECT_EQ(box.change_tool(next, tool), Reason::kNotAtRest) << "until the recording is written";
}

}  // namespace
}  // namespace surg
