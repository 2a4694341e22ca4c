// Messages to values: wrong forms are refused with words, NaN passes through to the controller
// (F01).
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <set>
#include <string>

#include "surg_control/topics/decode.hpp"
#include "surg_control/topics/messages.hpp"

namespace surg_control {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

geometry_msgs::PoseStamped pose(const std::string& frame = "PSM1_rcm") {
  geometry_msgs::PoseStamped message;
  message.header.frame_id = frame;
  message.pose.position.z = 0.12;
  message.pose.orientation.w = 1;
  return message;
}

TEST(Messages, PoseInItsFrame) {
  for (const std::string frame : {"PSM1_rcm", ""}) {
    const Decoded decoded = decode_pose(pose(frame), surg::Motion::kMoveCp);
    EXPECT_EQ(decoded.reason, surg::Reason::kNone);
    EXPECT_EQ(decoded.item.motion.motion, surg::Motion::kMoveCp);
    EXPECT_EQ(decoded.item.motion.p, surg::Vector3(0, 0, 0.12));
    EXPECT_STREQ(decoded.item.frame.c_str(), frame.c_str());
  }
  const Decoded wrong = decode_pose(pose(std::string(64, 'x')), surg::Motion::kServoCp);
  EXPECT_EQ(wrong.reason, surg::Reason::kWrongFrame);
  EXPECT_NE(wrong.detail.find("63 characters"), std::string::npos);
}

TEST(Messages, QuaternionMustBeUnit) {
  geometry_msgs::PoseStamped message = pose();
  message.pose.orientation.w = 1.0005;
  const Decoded near = decode_pose(message, surg::Motion::kServoCp);
  EXPECT_EQ(near.reason, surg::Reason::kNone);
  EXPECT_NEAR(near.item.motion.rotation.norm(), 1.0, 1e-15);
  for (const double w : {0.0, 0.9, 1.1, 1e200, 1e308}) {
    message.pose.orientation.w = w;
    EXPECT_NE(decode_pose(message, surg::Motion::kServoCp).reason, surg::Reason::kNone) << w;
  }
}

TEST(Messages, NotFinitePassesToTheController) {
  for (const double bad : {kNan, HUGE_VAL, -HUGE_VAL}) {
    geometry_msgs::PoseStamped message = pose();
    message.pose.position.x = bad;
    Decoded decoded = decode_pose(message, surg::Motion::kServoCp);
    EXPECT_EQ(decoded.reason, surg::Reason::kNone);
    EXPECT_FALSE(decoded.item.motion.p.allFinite());

    message = pose();
    message.pose.orientation.y = bad;
    decoded = decode_pose(message, surg::Motion::kServoCp);
    EXPECT_EQ(decoded.reason, surg::Reason::kNone);
    EXPECT_FALSE(decoded.item.motion.p.allFinite());

    sensor_msgs::JointState joints;
    joints.position = {0, bad, 0.1, 0};
    decoded = decode_joints(joints, surg::Motion::kServoJp);
    EXPECT_EQ(decoded.reason, surg::Reason::kNone);
    EXPECT_FALSE(decoded.item.motion.joints.allFinite());

    geometry_msgs::TwistStamped twist;
    twist.twist.angular.z = bad;
    decoded = decode_twist(twist);
    EXPECT_EQ(decoded.reason, surg::Reason::kNone);
    EXPECT_FALSE(decoded.item.angular.allFinite());
  }
}

TEST(Messages, SizesAndNames) {
  sensor_msgs::JointState joints;
  joints.position = {1, 2, 3};
  EXPECT_EQ(decode_joints(joints, surg::Motion::kServoJp).reason, surg::Reason::kWrongSize);
  joints.position = {1, 2, 3, 4};
  EXPECT_EQ(decode_joints(joints, surg::Motion::kServoJp).item.motion.joints,
            surg::Vector4(1, 2, 3, 4));
  EXPECT_EQ(decode_joints(joints, surg::Motion::kServoJv).reason, surg::Reason::kWrongSize);
  joints.name = {"pitch", "yaw", "insertion", "roll"};
  EXPECT_EQ(decode_joints(joints, surg::Motion::kServoJp).reason, surg::Reason::kWrongSize);
  joints.name = {"yaw", "pitch", "insertion", "roll"};
  EXPECT_EQ(decode_joints(joints, surg::Motion::kServoJp).reason, surg::Reason::kNone);
  EXPECT_EQ(decode_angle(joints, surg::Motion::kJawServoJp).reason, surg::Reason::kWrongSize);
  joints.position = {0.5};
  EXPECT_EQ(decode_angle(joints, surg::Motion::kJawServoJp).item.motion.jaw, 0.5);
}

TEST(Messages, StateWords) {
  crtk_msgs::StringStamped message;
  for (const char* word : {"enable", "disable", "pause", "resume", "home", "unhome"}) {
    message.string = word;
    const Decoded decoded = decode_state(message);
    EXPECT_EQ(decoded.reason, surg::Reason::kNone);
    EXPECT_STREQ(word_of(decoded.item.state), word);
  }
  message.string = "Enable";
  EXPECT_NE(decode_state(message).detail.find("allowed"), std::string::npos);
}

TEST(Messages, EveryJointCommandTakesFourNumbers) {
  using surg::Motion;
  sensor_msgs::JointState joints;
  joints.position = {1, 2, 3, 4};
  joints.velocity = {5, 6, 7, 8};
  for (const Motion motion : {Motion::kServoJp, Motion::kServoJr, Motion::kInterpolateJp,
                              Motion::kMoveJp, Motion::kMoveJr}) {
    const Decoded decoded = decode_joints(joints, motion);
    EXPECT_EQ(decoded.reason, surg::Reason::kNone);
    EXPECT_EQ(decoded.item.motion.motion, motion);
    EXPECT_EQ(decoded.item.motion.joints, surg::Vector4(1, 2, 3, 4));
  }
  EXPECT_EQ(decode_joints(joints, Motion::kServoJv).item.motion.joints, surg::Vector4(5, 6, 7, 8));
  joints.name = {"a"};
  EXPECT_NE(decode_joints(joints, Motion::kMoveJp).detail.find("'a'"), std::string::npos);
}

TEST(Messages, StartAndStopAndNothingElse) {
  using surg::Motion;
  crtk_msgs::StringStamped message;
  for (const Motion motion : {Motion::kInsert, Motion::kWithdraw, Motion::kRetrace}) {
    message.string = "start";
    EXPECT_EQ(decode_start_stop(message, motion).item.motion.motion, motion);
    message.string = "stop";
    EXPECT_EQ(decode_start_stop(message, motion).item.motion.motion, Motion::kHold);
    for (const std::string& word : {std::string("Start"), std::string(), std::string(500, 'x')}) {
      message.string = word;
      const Decoded decoded = decode_start_stop(message, motion);
      EXPECT_NE(decoded.reason, surg::Reason::kNone);
      EXPECT_NE(decoded.detail.find("allowed are start, stop"), std::string::npos);
      EXPECT_LT(decoded.detail.size(), 120U);  // a long word is not said in full
    }
  }
}

TEST(Messages, FixedFramesAreNotConverted) {
  surg_msgs::PointVelocityStamped track;
  track.point.x = 1;
  track.velocity.y = 2;
  EXPECT_EQ(decode_track(track, "PSM1_base").item.kind, CommandItem::Kind::kTrack);
  EXPECT_EQ(decode_track(track, "PSM1_base").item.p_B, surg::Vector3(1, 0, 0));
  EXPECT_EQ(decode_track(track, "PSM1_base").item.v_B, surg::Vector3(0, 2, 0));
  track.header.frame_id = "PSM1_rcm";
  const Decoded wrong = decode_track(track, "PSM1_base");
  EXPECT_EQ(wrong.reason, surg::Reason::kWrongFrame);
  EXPECT_NE(wrong.detail.find("'PSM1_rcm'; allowed is 'PSM1_base'"), std::string::npos);
  EXPECT_EQ(decode_rcm(pose("world"), "PSM1_base").reason, surg::Reason::kWrongFrame);
}

TEST(Messages, EveryMotionHasATopic) {
  std::set<std::string> topics;
  for (int i = 0; i <= 16; ++i) topics.insert(topic_of(static_cast<surg::Motion>(i)));
  EXPECT_EQ(topics.size(), 17U);
  EXPECT_EQ(topics.count("unknown"), 0U);
}

TEST(Messages, CycleCarriesTierAndEveryRefusal) {
  CycleRecord record;
  record.out.tier = 2;
  record.out.refused = 3;
  record.refused_by_node = 4;
  record.refused_by_cycle = 5;
  surg_msgs::Cycle message;
  encode_cycle(record, "PSM1_base", SourceTable(), message);
  EXPECT_EQ(message.tier, 2);
  EXPECT_EQ(message.refused, 12U);
  EXPECT_EQ(message.source, "");
}

TEST(Messages, CycleCarriesAWristUntilAStraightToolIsMounted) {
  CycleRecord record;
  record.out.wrist.exists = true;
  record.out.wrist.geometry = {0.009, 0.010, 0.3};
  record.out.wrist.q = {1, 2};
  record.out.wrist.set = {3, 4};
  record.out.wrist.goal = {5, 6};
  record.q_RTool = Eigen::Quaterniond(0.1, 0.2, 0.3, 0.4);
  surg_msgs::Cycle message;
  encode_cycle(record, "PSM1_base", SourceTable(), message);
  EXPECT_EQ(message.wrist_geometry, (std::vector<double>{0.009, 0.010, 0.3}));
  EXPECT_EQ(message.wrist, (std::vector<double>{1, 2}));
  EXPECT_EQ(message.wrist_set, (std::vector<double>{3, 4}));
  EXPECT_EQ(message.wrist_goal, (std::vector<double>{5, 6}));
  EXPECT_EQ(message.q_tip, (std::vector<double>{0.2, 0.3, 0.4, 0.1}));
  record.out.wrist.exists = false;
  encode_cycle(record, "PSM1_base", SourceTable(), message);
  EXPECT_TRUE(message.wrist.empty());
  EXPECT_TRUE(message.q_goal.empty());
}

TEST(Messages, RobotStateByName) {
  sensor_msgs::JointState message;
  message.name = {"a", "b"};
  message.position = {1, kNan};
  message.velocity = {3, 4};
  message.header.stamp = to_time(123'002'000'000ULL);
  LinkState link;
  EXPECT_EQ(decode_state_of_robot(message, {"a", "b"}, link), "");
  EXPECT_EQ(link.stamp_ns, 123'002'000'000ULL);
  EXPECT_EQ(link.qd[1], 4);
  EXPECT_TRUE(std::isnan(link.q[1]));  // F02 is the controller's
  EXPECT_NE(decode_state_of_robot(message, {"b", "a"}, link), "");
  message.velocity.pop_back();
  EXPECT_NE(decode_state_of_robot(message, {"a", "b"}, link), "");
}

TEST(Messages, AWristTakesSixJoints) {
  sensor_msgs::JointState joints;
  joints.position = {1, 2, 3, 4, 5, 6};
  const Decoded decoded = decode_joints(joints, surg::Motion::kServoJp, true);
  EXPECT_EQ(decoded.item.motion.joints, surg::Vector4(1, 2, 3, 4));
  EXPECT_EQ(decoded.item.motion.wrist, surg::DriveJoints(5, 6, 0));
  EXPECT_EQ(decode_joints(joints, surg::Motion::kServoJp).reason, surg::Reason::kWrongSize);
  joints.position.resize(4);
  EXPECT_NE(decode_joints(joints, surg::Motion::kServoJp, true).detail.find("wrist_yaw"),
            std::string::npos);
}

}  // namespace
}  // namespace surg_control
