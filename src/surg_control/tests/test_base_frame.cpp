// set_base_frame: what goes in comes out, and against products of homogeneous matrices, which share
// no line with the functions under test.
#include <gtest/gtest.h>

#include <cstdio>
#include <random>

#include "surg_control/topics/base_frame.hpp"
#include "surg_control/topics/decode.hpp"

namespace surg_control {
namespace {

class Random {
 public:
  double number(double most) { return std::uniform_real_distribution<>(-most, most)(engine_); }
  surg::Vector3 vector(double most) { return {number(most), number(most), number(most)}; }
  Eigen::Quaterniond rotation() {
    std::normal_distribution<> normal;
    Eigen::Quaterniond q(normal(engine_), normal(engine_), normal(engine_), normal(engine_));
    return q.normalized();
  }
  surg::Pose pose() {
    surg::Pose X = surg::Pose::Identity();
    X.linear() = rotation().toRotationMatrix();
    X.translation() = vector(2);
    return X;
  }

 private:
  std::mt19937 engine_{7};
};

Eigen::Matrix4d homogeneous(const surg::Vector3& p, const Eigen::Quaterniond& q) {
  Eigen::Matrix4d X = Eigen::Matrix4d::Identity();
  X.topLeftCorner<3, 3>() = q.toRotationMatrix();
  X.topRightCorner<3, 1>() = p;
  return X;
}

TEST(BaseFrame, PosesAgreeWithHomogeneousMatricesAndReturn) {
  Random random;
  double worst = 0;
  constexpr int kCount = 2000;
  for (int k = 0; k < kCount; ++k) {
    const surg::Pose X_UR = random.pose();
    const ToolPose in_U{random.vector(0.3), random.rotation()};
    const ToolPose in_R = pose_to_rcm(X_UR, in_U);
    // X_UTool = X_UR X_RTool, with the inverse taken by an LU decomposition.
    const Eigen::Matrix4d expected = X_UR.matrix().inverse() * homogeneous(in_U.p, in_U.q);
    worst = std::max(worst, (homogeneous(in_R.p, in_R.q) - expected).cwiseAbs().maxCoeff());
    const ToolPose back = pose_from_rcm(X_UR, in_R);
    worst = std::max(worst, (back.p - in_U.p).norm());
    worst = std::max(worst, back.q.angularDistance(in_U.q));
  }
  std::printf("%d poses, worst %.2g\n", kCount, worst);
  EXPECT_LT(worst, 5e-8);  // angularDistance has half the digits near zero
}

TEST(BaseFrame, TwistsAreTheDerivativesOfPoses) {
  Random random;
  constexpr double kStep = 1e-6;
  double worst = 0;
  for (int k = 0; k < 500; ++k) {
    const surg::Pose X_UR = random.pose();
    const ToolPose start{random.vector(0.3), random.rotation()};
    const ToolTwist in_R{random.vector(0.2), random.vector(1)};
    const double angle = in_R.omega.norm() * kStep;
    const ToolPose later{
        start.p + in_R.v * kStep,
        Eigen::Quaterniond(Eigen::AngleAxisd(angle, in_R.omega.normalized())) * start.q};
    const ToolPose a = pose_from_rcm(X_UR, start), b = pose_from_rcm(X_UR, later);
    const Eigen::AngleAxisd turn(b.q * a.q.conjugate());
    const ToolTwist in_U = twist_from_rcm(X_UR, in_R);
    worst = std::max(worst, ((b.p - a.p) / kStep - in_U.v).norm());
    worst = std::max(worst, (turn.axis() * turn.angle() / kStep - in_U.omega).norm());
    const ToolTwist back = twist_to_rcm(X_UR, in_U);
    worst = std::max(worst, (back.v - in_R.v).norm() + (back.omega - in_R.omega).norm());
  }
  std::printf("500 twists, worst %.2g\n", worst);
  EXPECT_LT(worst, 1e-6);
}

TEST(BaseFrame, IdentityChangesNoBit) {
  Random random;
  for (int k = 0; k < 200; ++k) {
    const ToolPose pose{random.vector(0.3), random.rotation()};
    const ToolPose same = pose_to_rcm(surg::Pose::Identity(), pose);
    EXPECT_EQ(same.p, pose.p);
    EXPECT_EQ(same.q.coeffs(), pose.q.coeffs());
    const ToolPose out = pose_from_rcm(surg::Pose::Identity(), pose);
    EXPECT_EQ(out.p, pose.p);
    EXPECT_EQ(out.q.coeffs(), pose.q.coeffs());
  }
}

geometry_msgs::PoseStamped frame_message(const std::string& name, double x) {
  geometry_msgs::PoseStamped message;
  message.header.frame_id = name;
  message.pose.position.x = x;
  message.pose.orientation.w = 1;
  return message;
}

TEST(BaseFrame, NameIsTheFrameIdAndNeverMeansTwoThings) {
  const auto decode = [](const geometry_msgs::PoseStamped& message) {
    return decode_base_frame(message, "PSM1_rcm", "PSM1_user");
  };
  EXPECT_STREQ(decode(frame_message("camera", 0.1)).item.frame.c_str(), "camera");
  EXPECT_STREQ(decode(frame_message("", 0.1)).item.frame.c_str(), "PSM1_user");
  EXPECT_STREQ(decode(frame_message("", 0)).item.frame.c_str(), "PSM1_rcm");
  EXPECT_STREQ(decode(frame_message("PSM1_rcm", 0)).item.frame.c_str(), "PSM1_rcm");
  const Decoded two_meanings = decode(frame_message("PSM1_rcm", 0.1));
  EXPECT_EQ(two_meanings.reason, surg::Reason::kWrongFrame);
  EXPECT_NE(two_meanings.detail.find("another name"), std::string::npos);
  EXPECT_EQ(decode(frame_message("camera", NAN)).reason, surg::Reason::kNotFinite);
  geometry_msgs::PoseStamped message = frame_message("camera", 0);
  message.pose.orientation.w = 0;
  EXPECT_EQ(decode(message).reason, surg::Reason::kNotFinite);
}

TEST(BaseFrame, LongNamesAreNotCutIntoOthers) {
  const std::string longest(FrameName::kLongest, 'a');
  EXPECT_TRUE(FrameName::fits(longest));
  EXPECT_FALSE(FrameName::fits(longest + "b"));
  EXPECT_FALSE(FrameName::fits(std::string("a\0b", 3)));
  EXPECT_EQ(FrameName(longest).c_str(), longest);
  EXPECT_NE(FrameName("a"), FrameName("ab"));
  EXPECT_TRUE(FrameName().empty());
}

}  // namespace
}  // namespace surg_control
