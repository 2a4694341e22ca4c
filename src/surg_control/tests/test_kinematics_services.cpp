// The kinematics queries: there and back, against the definition in docs/reference/conventions.md,
// and words for what has no answer.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <random>

#include "surg_control/topics/kinematics_services.hpp"
#include "surg_control/topics/virtual_kinematics.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {
namespace {

const surg::Limits& limits() {
  static const surg::Limits loaded =
      surg::load_arm(std::string(SURG_CELLS) + "/sim_ur5e", "").limits;
  return loaded;
}

TEST(KinematicsServices, ForwardAndInverseAgree) {
  std::mt19937 random(3);
  const auto number = [&random](double least, double most) {
    return std::uniform_real_distribution<>(least, most)(random);
  };
  surg::Pose X_UR = surg::Pose::Identity();
  X_UR.translation() = surg::Vector3(0.1, -0.2, 0.3);
  X_UR.linear() = Eigen::AngleAxisd(1.1, surg::Vector3(1, 2, 3).normalized()).toRotationMatrix();
  double worst = 0;
  constexpr int kCount = 2000;
  for (int k = 0; k < kCount; ++k) {
    crtk_msgs::QueryForwardKinematics::Request there;
    there.jp = {number(-0.7, 0.7), number(-0.7, 0.7), number(0.03, 0.2), number(-9, 9)};
    const auto pose = answer_forward(there, X_UR);
    ASSERT_TRUE(pose.result) << pose.message;
    crtk_msgs::QueryInverseKinematics::Request back;
    back.cp = pose.cp;
    back.jp = {0, 0, 0.1, there.jp[3] + number(-3, 3)};
    const auto joints = answer_inverse(back, X_UR, limits());
    ASSERT_TRUE(joints.result) << joints.message;
    for (int i = 0; i < 4; ++i) worst = std::max(worst, std::abs(joints.jp[i] - there.jp[i]));
  }
  std::printf("%d queries, worst %.2g\n", kCount, worst);
  EXPECT_LT(worst, 1e-9);
}

TEST(KinematicsServices, TipIsWhereTheConventionsSay) {
  crtk_msgs::QueryForwardKinematics::Request request;
  request.jp = {0.3, -0.2, 0.1, 0.4};
  const auto answer = answer_forward(request, surg::Pose::Identity());
  EXPECT_NEAR(answer.cp.position.x, 0.1 * std::sin(0.3) * std::cos(-0.2), 1e-15);
  EXPECT_NEAR(answer.cp.position.y, 0.1 * std::sin(-0.2), 1e-15);
  EXPECT_NEAR(answer.cp.position.z, 0.1 * std::cos(0.3) * std::cos(-0.2), 1e-15);
  request.jp = {0, 0, 0.1, 0.4};  // on the home axis the rotation is the roll
  const auto home = answer_forward(request, surg::Pose::Identity());
  EXPECT_NEAR(2 * std::atan2(home.cp.orientation.z, home.cp.orientation.w), 0.4, 1e-15);
}

TEST(KinematicsServices, TiltOfAPoseIsTheAngleToItsShaft) {
  for (const double tilt : {0.0, 0.01, 0.4, 2.0, M_PI}) {
    const ToolPose pose{{0, 0, 0.1},
                        Eigen::Quaterniond(Eigen::AngleAxisd(tilt, surg::Vector3::UnitX()) *
                                           Eigen::AngleAxisd(1.0, surg::Vector3::UnitZ()))};
    EXPECT_NEAR(ignored_tilt(pose), tilt, 1e-9);
  }
  EXPECT_EQ(ignored_tilt({surg::Vector3::Zero(), Eigen::Quaterniond::Identity()}), 0);
  EXPECT_EQ(ignored_tilt({surg::Vector3::Constant(NAN), Eigen::Quaterniond::Identity()}), 0);
}

TEST(KinematicsServices, WhatHasNoAnswerIsSaidWithValueAndAllowed) {
  const surg::Pose X_UR = surg::Pose::Identity();
  crtk_msgs::QueryForwardKinematics::Request there;
  there.jp = {1, 2, 3};
  EXPECT_FALSE(answer_forward(there, X_UR).result);
  EXPECT_NE(answer_forward(there, X_UR).message.find("has 3 values"), std::string::npos);
  there.jp = {1, 2, NAN, 3};
  EXPECT_FALSE(answer_forward(there, X_UR).result);

  crtk_msgs::QueryInverseKinematics::Request back;
  EXPECT_FALSE(answer_inverse(back, X_UR, limits()).result);  // quaternion 0
  back.cp.orientation.w = 1;
  EXPECT_FALSE(answer_inverse(back, X_UR, limits()).result);  // at the trocar point
  back.cp.position.z = 0.5;
  const auto deep = answer_inverse(back, X_UR, limits());
  EXPECT_FALSE(deep.result);
  EXPECT_NE(deep.message.find("500.0 mm"), std::string::npos) << deep.message;
  EXPECT_NE(deep.message.find("20.0 to 220.0 mm"), std::string::npos) << deep.message;
  back.cp.position.z = NAN;
  EXPECT_FALSE(answer_inverse(back, X_UR, limits()).result);
  back.cp.position.z = 0.1;
  EXPECT_TRUE(answer_inverse(back, X_UR, limits()).result);
  back.jp = {1, 2};
  EXPECT_FALSE(answer_inverse(back, X_UR, limits()).result);
}

TEST(KinematicsServices, AWristHasSixJointsBothWays) {
  std::optional<surg::WristConfig> wrist(surg::WristConfig{});
  wrist->geometry = {0.0091, 0.0102, 0.3};
  wrist->min = {-1.396, -1.396, 0};
  wrist->max = {1.396, 1.396, 0};
  const surg::Pose X_UR = surg::Pose::Identity();
  crtk_msgs::QueryForwardKinematics::Request there;
  there.jp = {0.1, -0.2, 0.1, 0.4, 0.7, -0.6};
  const auto pose = answer_forward(there, X_UR, wrist);
  ASSERT_TRUE(pose.result) << pose.message;
  crtk_msgs::QueryInverseKinematics::Request back;
  back.cp = pose.cp;
  const auto joints = answer_inverse(back, X_UR, limits(), wrist);
  ASSERT_TRUE(joints.result) << joints.message;
  ASSERT_EQ(joints.jp.size(), 6U);
  for (std::size_t i = 0; i < 6; ++i) EXPECT_NEAR(joints.jp[i], there.jp[i], 1e-9) << i;
  there.jp[4] = 1.45;
  back.cp = answer_forward(there, X_UR, wrist).cp;
  const auto beyond = answer_inverse(back, X_UR, limits(), wrist);
  EXPECT_FALSE(beyond.result);
  EXPECT_NE(beyond.message.find("wrist_pitch at 1.450"), std::string::npos) << beyond.message;
  there.jp.resize(4);
  EXPECT_NE(answer_forward(there, X_UR, wrist).message.find("needed are 6"), std::string::npos);
}

}  // namespace
}  // namespace surg_control
