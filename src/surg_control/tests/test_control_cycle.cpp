// The cycle round the controller: frames, ages, ignored parts, what is answered and in which order.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "support/ideal_arm.hpp"
#include "surg_control/topics/virtual_kinematics.hpp"

namespace surg_control {
namespace {

surg::Pose some_frame() {
  surg::Pose X_UR = surg::Pose::Identity();
  X_UR.linear() = Eigen::AngleAxisd(0.7, surg::Vector3(1, -2, 0.5).normalized()).toRotationMatrix();
  X_UR.translation() = surg::Vector3(0.2, 0.4, -0.1);
  return X_UR;
}

TEST(ControlCycle, F33ALinkThatNeverSaidItsConditionOrNoLongerDoesIsLost) {
  IdealArm silent;
  silent.says_its_condition = false;
  silent.step();
  EXPECT_EQ(silent.step({IdealArm::state(surg::StateCommand::kEnable)}).answers[0].reason,
            surg::Reason::kLinkLost);
  IdealArm arm;
  arm.enable();
  arm.says_its_condition = false;
  int k = 1;
  while (arm.step().out.state == surg::State::kEnabled && k < 1000) ++k;
  EXPECT_EQ(arm.cycle->record().out.reason, surg::Reason::kLinkLost);
  constexpr double kTwoPeriodsOfTheStatus = 0.040;  // [s] robot/status comes at 50 Hz
  EXPECT_EQ(k, std::lround((arm.link_timeout() + kTwoPeriodsOfTheStatus) / kTick) + 1);
}

TEST(ControlCycle, F33AConditionFaultsInItsOwnCycle) {
  IdealArm arm;
  arm.enable();
  arm.link.condition = surg::RobotCondition::kEstop;
  const CycleRecord& record = arm.step();
  EXPECT_EQ(record.out.state, surg::State::kFault);
  EXPECT_EQ(record.out.reason, surg::Reason::kRobot);
}

TEST(ControlCycle, F25AnArmThatRequiresAForcePausesWhileItIsNotKnown) {
  IdealArm arm;
  arm.cycle->require_force_below(0.03);
  arm.step();
  ASSERT_GT(arm.step().out.depth, 0.03);
  // Nobody has spoken yet.
  EXPECT_EQ(arm.step({IdealArm::state(surg::StateCommand::kEnable)}).answers[0].reason,
            surg::Reason::kForce);
  const auto say = [&arm](bool known) {
    const double value = known ? 0.0 : std::numeric_limits<double>::infinity();
    arm.link.tip = arm.link.trocar = {surg::Vector3::Constant(value), arm.now_ns};
  };
  say(true);
  arm.step();
  arm.enable();
  say(false);  // the sensor says that it does not know
  const CycleRecord& record = arm.step();
  EXPECT_EQ(record.out.state, surg::State::kPaused);
  EXPECT_EQ(record.out.reason, surg::Reason::kForce);
  say(false);
  EXPECT_EQ(arm.step({IdealArm::state(surg::StateCommand::kResume)}).answers[0].reason,
            surg::Reason::kForce);
  say(true);
  arm.step();
  say(true);
  EXPECT_EQ(arm.step({IdealArm::state(surg::StateCommand::kResume)}).answers[0].reason,
            surg::Reason::kNone);
}

TEST(ControlCycle, F25AForceThatIsNotKnownStopsNoArmThatDoesNotRequireIt) {
  for (const double depth : {std::numeric_limits<double>::infinity(), 0.5}) {
    IdealArm arm;
    arm.cycle->require_force_below(depth);  // none; deeper than the tip is
    arm.enable();
    arm.link.tip = arm.link.trocar = {
        surg::Vector3::Constant(std::numeric_limits<double>::infinity()), arm.now_ns};
    EXPECT_EQ(arm.step().out.state, surg::State::kEnabled);
  }
}

TEST(ControlCycle, ATargetInTheUsersFrameIsTheSameTarget) {
  IdealArm plain, user;
  plain.enable();
  user.step({IdealArm::frame("camera", some_frame())});
  user.enable();
  ToolPose target = plain.tip();
  target.p += surg::Vector3(0.02, -0.01, 0.01);
  const CycleRecord& a = plain.step({IdealArm::pose(surg::Motion::kMoveCp, target)});
  const CycleRecord& b = user.step(
      {IdealArm::pose(surg::Motion::kMoveCp, pose_from_rcm(some_frame(), target), "camera")});
  EXPECT_EQ(a.out.verdicts[0].reason, surg::Reason::kNone);
  EXPECT_EQ(b.out.verdicts[0].reason, surg::Reason::kNone);
  EXPECT_LT((a.out.p_goal - b.out.p_goal).norm(), 1e-12);
  EXPECT_NEAR(a.out.roll_goal, b.out.roll_goal, 1e-12);
  for (int k = 0; k < 600; ++k) plain.step(), user.step();
  EXPECT_LT((plain.tip().p - user.tip().p).norm(), 1e-9);
  EXPECT_LT((plain.tip().p - target.p).norm(), 5e-4);
}

TEST(ControlCycle, AVelocityInTheUsersFrameIsTheSameVelocity) {
  IdealArm plain, user;
  plain.enable();
  user.step({IdealArm::frame("camera", some_frame())});
  user.enable();
  CommandItem item;
  item.source = 1;
  item.motion.motion = surg::Motion::kServoCv;
  item.motion.p = surg::Vector3(0.01, 0.02, -0.005);
  item.angular = surg::Vector3(0, 0, 0.3);
  CommandItem turned = item;
  const ToolTwist in_U = twist_from_rcm(some_frame(), {item.motion.p, item.angular});
  turned.motion.p = in_U.v;
  turned.angular = in_U.omega;
  for (int k = 0; k < 100; ++k) plain.step({item}), user.step({turned});
  EXPECT_LT((plain.link.q - user.link.q).norm(), 1e-9);
  EXPECT_GT((plain.tip().p - surg::Vector3(plain.tip().p.x(), 0, 0)).norm(), 1e-3);
}

TEST(ControlCycle, FrameChangesOnlyWhileNotEnabled) {
  IdealArm arm;
  const auto answer = [](const CycleRecord& record) { return record.answers[0].reason; };
  EXPECT_EQ(answer(arm.step({IdealArm::frame("a", some_frame())})), surg::Reason::kNone);
  arm.enable();
  const CycleRecord& refused = arm.step({IdealArm::frame("b", some_frame())});
  EXPECT_EQ(answer(refused), surg::Reason::kFrameWhileEnabled);
  EXPECT_STREQ(refused.frame.name.c_str(), "a");
  const CycleRecord& paused =
      arm.step({IdealArm::frame("b", some_frame()), IdealArm::state(surg::StateCommand::kPause)});
  EXPECT_STREQ(paused.frame.name.c_str(), "a");  // it came before the pause
  EXPECT_EQ(answer(arm.step({IdealArm::frame("b", some_frame())})), surg::Reason::kNone);
  const CycleRecord& resumed =
      arm.step({IdealArm::state(surg::StateCommand::kResume), IdealArm::frame("c", some_frame())});
  EXPECT_EQ(resumed.answers[1].reason, surg::Reason::kFrameWhileEnabled);
  EXPECT_STREQ(resumed.frame.name.c_str(), "b");
}

TEST(ControlCycle, OnlyTheExpectedFrameIsTaken) {
  IdealArm arm;
  arm.enable();
  const ToolPose here = arm.tip();
  const CycleRecord& wrong = arm.step({IdealArm::pose(surg::Motion::kServoCp, here, "world")});
  EXPECT_EQ(wrong.answers[0].reason, surg::Reason::kWrongFrame);
  EXPECT_EQ(wrong.answers[0].motion, surg::Motion::kServoCp);
  EXPECT_STREQ(wrong.wrong_frame.c_str(), "world");
  EXPECT_EQ(wrong.refused_by_cycle, 1U);
  EXPECT_EQ(wrong.out.n_verdicts, 0);
  for (const std::string name : {"PSM1_rcm", ""}) {
    const CycleRecord& taken = arm.step({IdealArm::pose(surg::Motion::kServoCp, here, name)});
    EXPECT_EQ(taken.n_answers, 0);
    EXPECT_EQ(taken.out.verdicts[0].reason, surg::Reason::kNone);
  }
  arm.step({IdealArm::state(surg::StateCommand::kDisable)});
  arm.step({IdealArm::frame("camera", some_frame())});
  arm.step({IdealArm::state(surg::StateCommand::kEnable)});
  EXPECT_EQ(arm.step({IdealArm::pose(surg::Motion::kServoCp, here, "PSM1_rcm")}).answers[0].reason,
            surg::Reason::kWrongFrame);
}

TEST(ControlCycle, NotFiniteSurvivesTheFrame) {
  for (const double bad : std::vector<double>{NAN, HUGE_VAL, -HUGE_VAL, 1e308}) {
    IdealArm arm;
    arm.step({IdealArm::frame("camera", some_frame())});
    arm.enable();
    ToolPose target = pose_from_rcm(some_frame(), arm.tip());
    target.p.x() = bad;
    const CycleRecord& record =
        arm.step({IdealArm::pose(surg::Motion::kServoCp, target, "camera")});
    EXPECT_NE(record.out.verdicts[0].reason, surg::Reason::kNone) << bad;
    EXPECT_TRUE(record.out.qd_command.allFinite());
  }
}

TEST(ControlCycle, SaysWhatFourDegreesOfFreedomCannotFollow) {
  IdealArm arm;
  arm.enable();
  ToolPose target = arm.tip();
  EXPECT_EQ(arm.step({IdealArm::pose(surg::Motion::kServoCp, target)}).orientation.motion,
            surg::Motion::kNone);
  target.q = target.q * Eigen::AngleAxisd(0.01, surg::Vector3::UnitZ());  // roll is followed
  EXPECT_EQ(arm.step({IdealArm::pose(surg::Motion::kServoCp, target)}).orientation.motion,
            surg::Motion::kNone);
  target.q = target.q * Eigen::AngleAxisd(0.3, surg::Vector3::UnitX());
  EXPECT_EQ(arm.step({IdealArm::pose(surg::Motion::kServoCp, target)}).orientation.motion,
            surg::Motion::kServoCp);
  EXPECT_EQ(arm.step().orientation.motion, surg::Motion::kNone);

  CommandItem twist;
  twist.source = 1;
  twist.motion.motion = surg::Motion::kServoCv;
  const surg::Vector3 s_R = arm.tip().p.normalized();
  twist.angular = 0.5 * s_R;
  EXPECT_EQ(arm.step({twist}).angular.motion, surg::Motion::kNone);
  EXPECT_NEAR(arm.cycle->inputs().commands[0].roll_rate, 0.5, 1e-3);
  twist.angular = 0.5 * s_R.cross(surg::Vector3::UnitX()).normalized();
  EXPECT_EQ(arm.step({twist}).angular.motion, surg::Motion::kServoCv);
  EXPECT_NEAR(arm.cycle->inputs().commands[0].roll_rate, 0, 1e-3);
}

TEST(ControlCycle, AgesAreCountedFromReceipt) {
  IdealArm arm;
  EXPECT_FALSE(arm.cycle->inputs().state_valid);
  arm.step();
  EXPECT_EQ(arm.cycle->inputs().state_age, 0);
  EXPECT_EQ(arm.cycle->inputs().jaw_age, 0);
  const std::int64_t later = arm.now_ns + 30'000'000;
  arm.link.jaw_received_ns = later - 7'000'000;
  arm.cycle->run(arm.link, later, 0, nullptr, 0);
  EXPECT_NEAR(arm.cycle->inputs().state_age, 0.030, 1e-12);
  EXPECT_NEAR(arm.cycle->inputs().jaw_age, 0.007, 1e-12);
  arm.link.jaw_received_ns = 0;
  arm.cycle->run(arm.link, later, 0, nullptr, 0);
  EXPECT_EQ(arm.cycle->inputs().jaw_age, HUGE_VAL);  // the tool link has never spoken
}

TEST(ControlCycle, TrackAgesAndListensToOneTracker) {
  IdealArm arm(true);
  arm.step();
  EXPECT_FALSE(arm.cycle->inputs().track_valid);
  CommandItem item;
  item.kind = CommandItem::Kind::kTrack;
  item.source = 5;
  item.p_B = surg::Vector3(1, 2, 3);
  item.v_B = surg::Vector3(4, 5, 6);
  EXPECT_EQ(arm.step({item}).answers[0].reason, surg::Reason::kNone);
  EXPECT_TRUE(arm.cycle->inputs().track_valid);
  EXPECT_EQ(arm.cycle->inputs().track_age, 0);
  EXPECT_EQ(arm.cycle->inputs().p_BTrack, surg::Vector3(1, 2, 3));
  EXPECT_EQ(arm.cycle->inputs().v_BTrack, surg::Vector3(4, 5, 6));
  arm.step();
  EXPECT_NEAR(arm.cycle->inputs().track_age, kTick, 1e-12);
  CommandItem other = item;
  other.source = 6;
  EXPECT_EQ(arm.step({other}).answers[0].reason, surg::Reason::kNoAuthority);
  for (int k = 0; k < 50; ++k) arm.step();
  EXPECT_EQ(arm.step({other}).answers[0].reason, surg::Reason::kNone);
  EXPECT_EQ(arm.step({item}).answers[0].reason, surg::Reason::kNoAuthority);
}

TEST(ControlCycle, AClaimKeepsOthersOut) {
  IdealArm arm;
  arm.enable();
  CommandItem claim;
  claim.kind = CommandItem::Kind::kClaim;
  claim.source = 7;
  EXPECT_EQ(arm.step({claim}).answers[0].reason, surg::Reason::kNone);
  for (int k = 0; k < 500; ++k) arm.step();  // a second of rest does not end a claim
  EXPECT_EQ(arm.cycle->record().out.source, 7U);
  const CycleRecord& other = arm.step({IdealArm::pose(surg::Motion::kServoCp, arm.tip())});
  EXPECT_EQ(other.out.verdicts[0].reason, surg::Reason::kNoAuthority);
  claim.source = 1;
  EXPECT_EQ(arm.step({claim}).answers[0].reason, surg::Reason::kNoAuthority);
  arm.step({IdealArm::state(surg::StateCommand::kPause)});
  arm.step({IdealArm::state(surg::StateCommand::kResume)});
  const CycleRecord& after = arm.step({IdealArm::pose(surg::Motion::kServoCp, arm.tip())});
  EXPECT_EQ(after.out.verdicts[0].reason, surg::Reason::kNone);
}

TEST(ControlCycle, AToolIsNamedFromTheCycleInWhichItIsMounted) {
  IdealArm arm;
  arm.enable();
  surg::MountedTool next = surg::load_arm(std::string(SURG_CELLS) + "/sim_ur5e", "").mounted;
  next.tool.p_FTip.z() += 0.01;
  CommandItem mount;
  mount.kind = CommandItem::Kind::kTool;
  mount.source = 7;
  mount.tool = &next;
  EXPECT_EQ(arm.step({mount}).answers[0].reason, surg::Reason::kToolWhileEnabled);
  EXPECT_EQ(arm.cycle->record().tool, nullptr);
  const double depth = arm.cycle->record().out.depth;
  arm.step({IdealArm::state(surg::StateCommand::kDisable)});
  const CycleRecord& changed = arm.step({mount});
  EXPECT_EQ(changed.answers[0].reason, surg::Reason::kNone);
  EXPECT_EQ(changed.tool, &next);
  EXPECT_NEAR(changed.out.depth, depth + 0.01, 1e-6);
  EXPECT_FALSE(changed.out.homed);
  EXPECT_EQ(LinkCommand::of(changed).tool, &next);
}

TEST(ControlCycle, ASenderMaySlideAlongTheWallAndOthersAreRefused) {
  IdealArm arm;
  arm.enable();
  CommandItem wish;
  wish.kind = CommandItem::Kind::kAtWall;
  wish.source = 7;
  wish.slide = true;
  EXPECT_EQ(arm.step({wish}).answers[0].reason, surg::Reason::kNone);
  CommandItem pose = IdealArm::pose(surg::Motion::kServoCp, arm.tip());
  pose.stamp_ns = 5'000'000'000;
  arm.step({pose});
  EXPECT_FALSE(arm.cycle->inputs().commands[0].slide);
  EXPECT_EQ(arm.cycle->inputs().commands[0].stamp_ns, 5'000'000'000);
  EXPECT_EQ(arm.cycle->inputs().commands[0].age, 0);
  pose.source = 7;
  arm.step({pose});
  EXPECT_TRUE(arm.cycle->inputs().commands[0].slide);
  wish.slide = false;
  arm.step({wish, pose});
  EXPECT_FALSE(arm.cycle->inputs().commands[0].slide);
}

/// F03: a network stalls while a hand streams, and delivers everything when the stall ends.
TEST(ControlCycle, WhatWasSentBeforeTheStopIsLateAndMovesNothing) {
  IdealArm arm;
  arm.enable();
  const ToolPose start = arm.tip();
  const auto answer = [&](int k, surg::Motion motion = surg::Motion::kServoCp) {
    ToolPose target = start;
    target.p.x() += 1e-4 * k;
    CommandItem item = IdealArm::pose(motion, target);
    item.stamp_ns = arm.cycle->record().stamp_ns;  // of the cycle that its sender saw
    return item;
  };
  int k = 0;
  for (; k < 20; ++k) {
    EXPECT_EQ(arm.step({answer(k)}).out.verdicts[0].reason, surg::Reason::kNone);
  }
  std::vector<CommandItem> stalled;  // the hand goes on until it notices the silence
  for (int late = 0; late < 8; ++late) stalled.push_back(answer(k + late));
  CommandItem jaw = answer(0, surg::Motion::kJawServoJp);
  jaw.motion.jaw = 0.5;
  stalled.push_back(jaw);
  for (int silent = 0; silent < 150; ++silent) arm.step();
  EXPECT_EQ(arm.cycle->record().out.motion, surg::Motion::kNone);
  const surg::Vector3 p_set = arm.cycle->record().out.p_set;
  const double jaw_set = arm.cycle->record().out.jaw_set;
  const CycleRecord& burst = arm.step(stalled);
  ASSERT_EQ(burst.n_answers, static_cast<int>(stalled.size()));
  for (int i = 0; i < burst.n_answers; ++i) {
    EXPECT_EQ(burst.answers[i].reason, surg::Reason::kLate);
    EXPECT_EQ(burst.answers[i].motion, stalled[i].motion.motion);
  }
  EXPECT_EQ(burst.refused_by_cycle, stalled.size());
  EXPECT_EQ(burst.out.n_verdicts, 0);
  for (int after = 0; after < 200; ++after) arm.step();
  EXPECT_EQ(arm.cycle->record().out.p_set, p_set);
  EXPECT_EQ(arm.cycle->record().out.jaw_set, jaw_set);
  EXPECT_EQ(arm.cycle->record().out.state, surg::State::kEnabled);
  // A hold is obeyed however late it comes; an answer to the arm at rest begins a new stream.
  CommandItem hold = answer(0, surg::Motion::kHold);
  hold.stamp_ns = stalled[0].stamp_ns;
  EXPECT_EQ(arm.step({hold}).out.verdicts[0].reason, surg::Reason::kNone);
  for (int quiet = 0; quiet < 60; ++quiet) arm.step();
  CommandItem anew = IdealArm::pose(surg::Motion::kServoCp, arm.tip());
  anew.stamp_ns = arm.cycle->record().stamp_ns;
  EXPECT_EQ(arm.step({anew}).out.verdicts[0].reason, surg::Reason::kNone);
}

}  // namespace
}  // namespace surg_control
