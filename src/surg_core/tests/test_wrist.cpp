// The closed form of a wrist against its own forward way, a numerical inverse and differences, and
// a controller that holds a tip pose behind a drive with a lag of its own.
#include <gtest/gtest.h>

#include <cmath>
#include <deque>
#include <iostream>
#include <random>

#include "support/next_command.hpp"
#include "support/next_joints.hpp"
#include "support/test_arm.hpp"
#include "support/test_support.hpp"
#include "surg_core/controller.hpp"
#include "surg_core/kinematics/wrist.hpp"
#include "surg_core/law/exact.hpp"

namespace surg {
namespace {

const WristGeometry kGeometry{0.0091, 0.0102, 0.4};
constexpr double kT = 0.002;

WristPose any_wrist(std::mt19937& draws, double most = 1.4) {
  std::uniform_real_distribution<double> unit(-1, 1);
  const Vector3 s = Vector3(0.8 * unit(draws), 0.8 * unit(draws), 1).normalized();
  WristPose pose;
  pose.centre.p = (0.08 + 0.05 * unit(draws)) * s;
  pose.centre.R = shaft_rotation(s, M_PI * unit(draws));
  pose.joints = {most * unit(draws), most * unit(draws)};
  return pose;
}

double difference(const WristPose& a, const WristPose& b) {
  return std::max({(a.centre.p - b.centre.p).cwiseAbs().maxCoeff(),
                   (a.centre.R - b.centre.R).cwiseAbs().maxCoeff(),
                   (a.joints - b.joints).cwiseAbs().maxCoeff()});
}

/// Inverse without the closed form: Gauss-Newton on joints of the shaft and the wrist from nearby.
WristPose by_iteration(const TipFrame& wanted, WristPose from) {
  for (int i = 0; i < 60; ++i) {
    const TipFrame now = tip_of_wrist(kGeometry, from);
    const Eigen::AngleAxisd turn(Matrix3(wanted.R * now.R.transpose()));
    FrameRate missing{wanted.p - now.p, turn.angle() * turn.axis()};
    if (missing.v.norm() + missing.omega.norm() < 1e-14) break;
    Eigen::Matrix<double, 6, 6> J;  // by differences, h in x, y, z, roll, pitch, yaw
    constexpr double h = 1e-6;
    const auto moved = [&](const Vector6& x) {
      WristPose pose = from;
      pose.centre.p += x.head<3>();
      const Vector3 s_before = from.centre.p.normalized(), s = pose.centre.p.normalized();
      pose.centre.R = Eigen::AngleAxisd(x[3], s).toRotationMatrix() *
                      minimal_rotation(s_before, s) * from.centre.R;
      pose.joints += x.tail<2>();
      return pose;
    };
    for (int k = 0; k < 6; ++k) {
      const TipFrame more = tip_of_wrist(kGeometry, moved(h * Vector6::Unit(k)));
      const TipFrame less = tip_of_wrist(kGeometry, moved(-h * Vector6::Unit(k)));
      const Eigen::AngleAxisd d(Matrix3(more.R * less.R.transpose()));
      J.col(k) << (more.p - less.p) / (2 * h), d.angle() * d.axis() / (2 * h);
    }
    Vector6 target;
    target << missing.v, missing.omega;
    from = moved(J.fullPivLu().solve(target));
  }
  return from;
}

TEST(Wrist, TheClosedFormInvertsItsForwardWay) {
  std::mt19937 draws(1);
  const int n = test::family(50'000, 1'000'000);
  double worst = 0, worst_pose = 0;
  for (int i = 0; i < n; ++i) {
    const WristPose pose = any_wrist(draws);
    const TipFrame tip = tip_of_wrist(kGeometry, pose);
    const auto found = wrists_of_tip(kGeometry, tip);
    ASSERT_TRUE(found.has_value());
    worst = std::max(worst, difference((*found)[0], pose));
    for (const WristPose& branch : *found) {
      const TipFrame again = tip_of_wrist(kGeometry, branch);
      worst_pose = std::max({worst_pose, (again.p - tip.p).norm(), (again.R - tip.R).norm()});
      EXPECT_NEAR(branch.centre.p.normalized().dot(branch.centre.R.col(2)), 1, 1e-12);
    }
    EXPECT_LT(std::abs((*found)[0].joints[0]), M_PI_2);
    EXPECT_GT(std::abs((*found)[1].joints[0]), M_PI_2);
  }
  EXPECT_LT(worst, 1e-9) << n << " poses";
  EXPECT_LT(worst_pose, 1e-9) << n << " poses, both branches";
}

/// As `difference`, where a joint may have gone round once more.
double turned_difference(const WristPose& a, WristPose b) {
  for (int i = 0; i < 2; ++i)
    b.joints[i] = a.joints[i] + std::remainder(b.joints[i] - a.joints[i], 2 * M_PI);
  return difference(a, b);
}

TEST(Wrist, TheClosedFormIsWhereIterationsEnd) {
  std::mt19937 draws(2);
  const int n = test::family(500, 1'000'000);
  double worst = 0;
  for (int i = 0; i < n; ++i) {
    const TipFrame tip = tip_of_wrist(kGeometry, any_wrist(draws, 1.3));
    for (const WristPose& branch : *wrists_of_tip(kGeometry, tip)) {
      WristPose near = branch;
      near.centre.p *= 1.02;
      near.joints += WristJoints(0.05, -0.05);
      worst = std::max(worst, turned_difference(by_iteration(tip, near), branch));
    }
  }
  std::cout << n << " poses, both branches: " << worst << " at most\n";
  EXPECT_LT(worst, 1e-9);
}

TEST(Wrist, ATipWhoseYawAxisPointsToTheTrocarHasNoAnswer) {
  TipFrame tip;
  tip.p = Vector3(0, 0, 0.1);
  tip.R.col(0) = Vector3::UnitZ();
  tip.R.col(2) = Vector3::UnitX();
  tip.R.col(1) = tip.R.col(2).cross(tip.R.col(0));
  tip.R = tip.R * Eigen::AngleAxisd(-kGeometry.turn, Vector3::UnitZ()).toRotationMatrix();
  tip.p += kGeometry.yaw_to_tip * tip.R.col(2);
  EXPECT_FALSE(wrists_of_tip(kGeometry, tip).has_value());
}

TEST(Wrist, RatesAreDifferencesOfTheForwardWay) {
  std::mt19937 draws(3);
  std::uniform_real_distribution<double> unit(-1, 1);
  for (int i = 0; i < 2000; ++i) {
    const WristPose pose = any_wrist(draws, 1.2);
    const FrameRate wanted{{0.1 * unit(draws), 0.1 * unit(draws), 0.1 * unit(draws)},
                           {3 * unit(draws), 3 * unit(draws), 3 * unit(draws)}};
    const WristRate rate = wrist_rates(kGeometry, pose, wanted);
    constexpr double h = 1e-6;
    const auto after = [&](double t) {
      WristPose there = pose;
      there.centre.p += t * rate.v_centre;
      const Vector3 s = there.centre.p.normalized();
      there.centre.R = Eigen::AngleAxisd(t * rate.roll_rate, s).toRotationMatrix() *
                       minimal_rotation(pose.centre.R.col(2), s) * pose.centre.R;
      there.joints += t * rate.joints;
      return tip_of_wrist(kGeometry, there);
    };
    const TipFrame more = after(h), less = after(-h);
    const Eigen::AngleAxisd turn(Matrix3(more.R * less.R.transpose()));
    const double fast = rate.joints.norm() + std::abs(rate.roll_rate);
    EXPECT_LT(((more.p - less.p) / (2 * h) - wanted.v).norm(), 1e-4 * (1 + fast));
    EXPECT_LT((turn.angle() * turn.axis() / (2 * h) - wanted.omega).norm(), 2e-3 * (1 + fast));
  }
}

TEST(Wrist, RatesStayBoundedAtTheSingularPose) {
  WristPose pose;
  pose.centre.p = Vector3(0, 0, 0.1);
  for (const double pitch : {1.5, 1.57, M_PI_2, 1.58}) {
    pose.joints = {pitch, 0.3};
    const WristRate rate = wrist_rates(kGeometry, pose, {Vector3(0.1, 0.1, 0.1), Vector3(1, 2, 3)});
    EXPECT_TRUE(rate.v_centre.allFinite() && rate.joints.allFinite());
    EXPECT_LT(std::abs(rate.roll_rate) + rate.joints.norm(), 2000);
  }
}

/// To a pose of the tip. With 'slide' the wrist goes to the end of its range, if need be.
MotionCommand to_tip(Motion motion, const Vector3& p, const Eigen::Quaterniond& rotation,
                     bool slide = false) {
  MotionCommand command = test::command(motion, p);
  command.rotation = rotation;
  command.slide = slide;
  return command;
}

/// A controller with a wrist, its arm (each joint with a lag) and a drive with another lag.
class WristBench {
 public:
  /// Of the drive: a lag of first order, of second order (critically damped), or a dead time.
  enum class Drive { kFirst, kSecond, kDeadTime };

  /// rolls: the drive turns the shaft, too.
  explicit WristBench(double drive_lag, double stated_lag, Drive drive = Drive::kSecond,
                      bool rolls = false)
      : robot_(test::robot_behind(test::good_robot(), kArmLag)),
        chain_(test::ur5e_chain()),
        controller_(chain_, robot_, with_roll_of(instrument(stated_lag, rolls), robot_.limits),
                    instrument(stated_lag, rolls), test::offset_tool(), {}),
        drive_lag_(drive_lag),
        drive_(drive),
        on_the_way_(std::lround(drive_lag / kT), DriveJoints::Zero()) {
    in_.state_valid = true;
    in_.q = robot_.home;
    in_.qd = JointVector::Zero(6);
    const Pose X_BF = chain_.forward(in_.q);
    const ToolCalibration tool = test::offset_tool();
    controller_.set_rcm(X_BF * tool.p_FTip - 0.12 * (X_BF.linear() * tool.s_F));
    tick();
    EXPECT_EQ(controller_.request(StateCommand::kHome), Reason::kNone);
    EXPECT_EQ(controller_.request(StateCommand::kEnable), Reason::kNone);
    tick();
  }

  const Outputs& tick() {
    out_ = &controller_.step(in_);
    in_.n_commands = 0;
    in_.qd += (1 - std::exp(-kT / kArmLag)) * (out_->qd_command - in_.qd);
    in_.q += kT * in_.qd;
    if (!held_) move_drive(out_->wrist.command);
    return *out_;
  }

  Reason send(MotionCommand command) {
    command.source = test::kMe;
    in_.commands[in_.n_commands++] = command;
    tick();
    return out_->verdicts[0].reason;
  }

  Reason servo_cp(const TipFrame& tip) {
    return send(to_tip(Motion::kServoCp, tip.p, Eigen::Quaterniond(tip.R)));
  }

  /// The true tip, from the joints of arm and drive alone.
  TipFrame tip() const {
    const Pose X_RF = controller_.X_BR().inverse() * chain_.forward(in_.q);
    const ToolCalibration tool = test::offset_tool();
    const Vector3 s = X_RF.linear() * tool.s_F;
    WristPose pose;
    pose.centre.p = X_RF * tool.p_FTip - kGeometry.length() * s;
    pose.centre.R = X_RF.linear() * R_FShaft() *
                    Eigen::AngleAxisd(in_.wrist[2], Vector3::UnitZ()).toRotationMatrix();
    pose.joints = in_.wrist.head<2>();
    return tip_of_wrist(mounted(), pose);
  }
  double pivot() const {
    const Pose X_BF = chain_.forward(in_.q);
    const ToolCalibration tool = test::offset_tool();
    return shaft_state(X_BF, {tool.s_F, tool.p_FTip}, controller_.X_BR().translation()).e.norm();
  }

  /// The wrist with its pitch axis along x of the flange, as the drawing would have it.
  WristGeometry mounted() const {
    const Vector3 axis_R =
        (controller_.X_BR().inverse() * chain_.forward(robot_.home)).linear() * pitch_axis_F();
    WristGeometry out = kGeometry;
    out.turn = std::atan2(-axis_R.x(), axis_R.y());
    return out;
  }
  static Vector3 pitch_axis_F() {
    return test::offset_tool().s_F.cross(Vector3::UnitY()).normalized();
  }

  void hold_drive() { held_ = true; }
  /// Turns the arm about the shaft's axis through the trocar [rad].
  void turn_by_hand(double arm) {
    const Pose X_BF = chain_.forward(in_.q);
    const Vector3 s = X_BF.linear() * test::offset_tool().s_F, p = controller_.X_BR().translation();
    Pose goal = X_BF;
    goal.linear() = Eigen::AngleAxisd(arm, s) * X_BF.linear();
    goal.translation() = p + Eigen::AngleAxisd(arm, s) * (X_BF.translation() - p);
    const JointVector free = JointVector::Zero(6);
    for (int i = 0; i < 10; ++i) in_.q = test::next_joints(chain_, in_.q, goal, free);
  }
  const Outputs& out() const { return *out_; }
  Inputs& in() { return in_; }
  Controller& controller() { return controller_; }

 private:
  static constexpr double kArmLag = 0.012;
  void move_drive(const DriveJoints& told) {
    const DriveJoints before = in_.wrist;
    if (drive_ == Drive::kFirst) in_.wrist += (1 - std::exp(-kT / drive_lag_)) * (told - before);
    if (drive_ == Drive::kSecond) {
      const double w = 2 / drive_lag_;
      constexpr int kFine = 10;
      for (int i = 0; i < kFine; ++i) {
        rate_ += kT / kFine * (w * w * (told - in_.wrist) - 2 * w * rate_);
        in_.wrist += kT / kFine * rate_;
      }
    }
    if (drive_ == Drive::kDeadTime) {
      on_the_way_.push_back(told);
      in_.wrist = on_the_way_.front();
      on_the_way_.pop_front();
    }
    in_.wrist_rate = (in_.wrist - before) / kT;
  }
  static InstrumentConfig instrument(double drive_lag, bool rolls) {
    InstrumentConfig out = test::instrument();
    WristConfig wrist;
    wrist.geometry.pitch_to_yaw = kGeometry.pitch_to_yaw;
    wrist.geometry.yaw_to_tip = kGeometry.yaw_to_tip;
    wrist.pitch_axis_F = pitch_axis_F();
    wrist.min = {-1.396, -1.396, rolls ? -2.5 : 0.0};
    wrist.max = {1.396, 1.396, rolls ? 2.5 : 0.0};
    wrist.velocity = 8;
    wrist.acceleration = 120;
    wrist.drive_lag = drive_lag;
    out.wrist = wrist;
    return out;
  }
  /// At home the shaft's rotation in the rcm frame is the identity.
  Matrix3 R_FShaft() const {
    return (controller_.X_BR().inverse() * chain_.forward(robot_.home)).linear().transpose();
  }

  RobotConfig robot_;
  Chain chain_;
  Controller controller_;
  double drive_lag_;
  Drive drive_;
  std::deque<DriveJoints> on_the_way_;
  DriveJoints rate_ = DriveJoints::Zero();
  bool held_ = false;
  Inputs in_;
  const Outputs* out_ = nullptr;
};

/// A hand that goes round and turns about all three axes, from rest at the home pose.
TipFrame hand_at(double t) {
  const double grow = 0.5 - 0.5 * std::cos(M_PI * std::min(1.0, t)), w = M_PI * t;
  TipFrame hand;
  hand.p = {0.012 * grow * std::sin(w), 0.010 * grow * (1 - std::cos(w)),
            0.12 + 0.008 * grow * std::sin(0.7 * w)};
  hand.R = (Eigen::AngleAxisd(0.6 * grow * std::sin(w), Vector3::UnitY()) *
            Eigen::AngleAxisd(0.5 * grow * std::sin(1.3 * w), Vector3::UnitX()) *
            Eigen::AngleAxisd(0.4 * grow * std::sin(0.9 * w), Vector3::UnitZ()))
               .toRotationMatrix();
  return hand;
}

struct PathError {
  double tip = 0, angle = 0, pivot = 0;  // [m], [rad], [m]
};

/// The same, and it rolls as quickly as a surgeon who ties a knot: 3.5 rad/s, 35 rad/s^2.
TipFrame quick_hand_at(double t) {
  TipFrame hand = hand_at(t);
  const double grow = 0.5 - 0.5 * std::cos(M_PI * std::min(1.0, t));
  hand.R = hand.R * Eigen::AngleAxisd(0.35 * grow * std::sin(10 * t), Vector3::UnitZ());
  return hand;
}

/// Largest distances of the tip from the hand's path of before, over a run behind a drive.
PathError follow_hand(double drive_lag, double stated_lag, WristBench::Drive drive,
                      bool rolls = false, TipFrame (*hand_at)(double) = hand_at) {
  WristBench bench(drive_lag, stated_lag, drive, rolls);
  constexpr int kTicks = 3000;
  std::vector<TipFrame> tips;
  PathError worst;
  for (int k = 0; k < kTicks; ++k) {
    EXPECT_EQ(bench.servo_cp(hand_at(k * kT)), Reason::kNone) << k;
    tips.push_back(bench.tip());
    worst.pivot = std::max(worst.pivot, bench.pivot());
  }
  // A common delay is no error of the path: the one at which the tip is nearest to the hand.
  double best = 1;
  for (int late = 0; late < 60; ++late) {
    PathError here;
    for (int k = 500; k < kTicks; ++k) {
      const TipFrame hand = hand_at((k - late) * kT);
      here.tip = std::max(here.tip, (tips[k].p - hand.p).norm());
      here.angle =
          std::max(here.angle, Eigen::AngleAxisd(Matrix3(hand.R.transpose() * tips[k].R)).angle());
    }
    if (here.tip > best) continue;
    best = worst.tip = here.tip;
    worst.angle = here.angle;
  }
  return worst;
}

/// The hand is followed behind a drive that lags as stated.
PathError expect_path(double lag, WristBench::Drive drive, bool rolls = false,
                      TipFrame (*hand)(double) = hand_at) {
  const PathError error = follow_hand(lag, lag, drive, rolls, hand);
  std::cout << lag << " s: tip " << 1e3 * error.tip << " mm, " << error.angle * 180 / M_PI
            << " degrees, pivot " << 1e6 * error.pivot << " um\n";
  EXPECT_LT(error.tip, 3e-4) << lag;
  EXPECT_LT(error.angle, 0.0175) << lag;
  EXPECT_LT(error.pivot, 1e-4) << lag;
  return error;
}

TEST(Wrist, TheTipKeepsItsPathBehindADriveThatLagsOtherwise) {
  using Drive = WristBench::Drive;
  for (const Drive drive : {Drive::kFirst, Drive::kSecond, Drive::kDeadTime})
    for (const double lag : {0.02, 0.04, 0.06}) {
      const PathError error = expect_path(lag, drive);
      // Unmatched, the tip leaves its path by speed times the difference of the lags.
      if (lag > 0.03) EXPECT_GT(follow_hand(lag, 0.012, drive).angle, 2 * error.angle) << lag;
    }
}

/// The arm's roll has 2 rad/s and 25 rad/s^2, which a surgeon's hand exceeds.
TEST(Wrist, ARollThatNoArmHasIsTheDrives) {
  const auto second = WristBench::Drive::kSecond;
  for (const double lag : {0.02, 0.04, 0.06}) expect_path(lag, second, true, quick_hand_at);
  EXPECT_GT(follow_hand(0.04, 0.04, second, false, quick_hand_at).angle, 0.05);
}

/// Roll commands name the sum; the arm keeps its part.
TEST(Wrist, JointCommandsNameTheWholeRoll) {
  WristBench bench(0.04, 0.04, WristBench::Drive::kSecond, true);
  MotionCommand command = test::joints(Motion::kMoveJp, Vector4(0.1, -0.1, 0.1, 1.5));
  command.wrist = {0.3, -0.4, 0};
  const auto arrive = [&] {
    ASSERT_EQ(bench.send(command), Reason::kNone);
    while (bench.tick().busy) {
    }
    for (int k = 0; k < 250; ++k) bench.tick();
  };
  arrive();
  EXPECT_NEAR(bench.out().virtual_q[3], 1.5, 1e-3);
  EXPECT_NEAR(bench.out().virtual_set[3], 1.5, 1e-12);
  EXPECT_NEAR(bench.in().wrist[2], 1.5, 1e-3);
  EXPECT_LT((bench.out().wrist.R_RTip - bench.tip().R).norm(), 1e-6);
  command.motion = Motion::kMoveJr;
  command.joints = {0, 0, 0, -0.5};
  command.wrist.setZero();
  arrive();
  EXPECT_NEAR(bench.out().roll, 1.0, 1e-3);
  EXPECT_NEAR(bench.out().roll_goal, 1.0, 1e-12);
  command.motion = Motion::kServoJv;
  for (int k = 0; k < 250; ++k) ASSERT_EQ(bench.send(command), Reason::kNone);
  EXPECT_NEAR(bench.out().roll_set, 0.75, 0.02);
  EXPECT_NEAR(bench.out().virtual_qd[3], -0.5, 1e-3);
  command.motion = Motion::kMoveJr;
  ASSERT_EQ(bench.send(command), Reason::kNone);
  EXPECT_NEAR(bench.out().roll_goal, bench.out().roll_set - 0.5, 0.01) << "from where it is now";
  command.motion = Motion::kMoveJp;
  command.joints = {0, 0, 0.1, 2.6};
  EXPECT_EQ(bench.send(command), Reason::kOutsideWorkspace) << "the drive ends at 2.5 rad";
}

TEST(Wrist, TheArmsOwnRollIsPartOfTheSum) {
  WristBench bench(0.04, 0.04, WristBench::Drive::kSecond, true);
  MotionCommand command = test::joints(Motion::kMoveJp, Vector4(0, 0, 0.1, 0.2));
  ASSERT_EQ(bench.send(command), Reason::kNone);
  for (int k = 0; k < 800; ++k) bench.tick();
  ASSERT_EQ(bench.controller().request(StateCommand::kPause), Reason::kNone);
  bench.tick();
  bench.turn_by_hand(0.3);
  for (int k = 0; k < 50; ++k) bench.tick();
  ASSERT_EQ(bench.controller().request(StateCommand::kResume), Reason::kNone);
  bench.tick();
  EXPECT_NEAR(bench.out().roll, 0.5, 1e-3);
  EXPECT_NEAR(bench.out().roll_set, 0.5, 1e-3);
  const TipFrame tip = bench.tip();
  for (int k = 0; k < 500; ++k) {
    const Eigen::AngleAxisd turn(0.001 * k, Vector3::UnitZ());
    ASSERT_EQ(bench.servo_cp({tip.p, tip.R * turn}), Reason::kNone) << k;
  }
  for (int k = 0; k < 40; ++k)
    bench.servo_cp({tip.p, tip.R * Eigen::AngleAxisd(0.5, Vector3::UnitZ())});
  EXPECT_NEAR(bench.in().wrist[2], 0.7, 2e-3);
  EXPECT_NEAR(bench.out().roll, 1.0, 2e-3);
  EXPECT_NEAR(bench.out().roll_set, 1.0, 1e-3);
  command.joints = {0, 0, 0.1, 0.6};
  ASSERT_EQ(bench.send(command), Reason::kNone);
  for (int k = 0; k < 800; ++k) bench.tick();
  EXPECT_NEAR(bench.out().roll, 0.6, 1e-3);
  EXPECT_NEAR(bench.in().wrist[2], 0.3, 2e-3);
}

TEST(Wrist, TheToolKeepsItsPlaceWhereTheDrivesRollEnds) {
  WristBench bench(0.04, 0.04, WristBench::Drive::kSecond, true);
  MotionCommand command = test::command(Motion::kServoCp, hand_at(0).p);
  for (int k = 0; k < 1600; ++k) {  // it turns on to 3 rad
    command.slide = k < 1500;
    command.rotation =
        Eigen::Quaterniond(Eigen::AngleAxisd(std::min(3.0, k * 0.0025), Vector3::UnitZ()));
    ASSERT_EQ(bench.send(command) == Reason::kNone, command.slide) << k;
    EXPECT_LE(bench.in().wrist[2], 2.5 + 1e-9);
  }
  EXPECT_NEAR(bench.out().roll, 2.5, 1e-3);
  EXPECT_LT((bench.tip().p - command.p).norm(), 1e-4);
}

TEST(Wrist, AMoveEndsAtThePoseThatWasAsked) {
  std::mt19937 draws(4);
  for (int i = 0; i < 20; ++i) {
    WristBench bench(0.04, 0.04, WristBench::Drive::kSecond, i % 2 == 1);
    WristPose pose = any_wrist(draws, 1.2);
    pose.centre.p = 0.1 * Vector3(0.2, -0.1, 1 + 0.01 * i).normalized();
    pose.centre.R = shaft_rotation(pose.centre.p.normalized(), 0.05 * i - 0.5);
    const TipFrame goal = tip_of_wrist(bench.mounted(), pose);
    ASSERT_EQ(bench.send(to_tip(Motion::kMoveCp, goal.p, Eigen::Quaterniond(goal.R))),
              Reason::kNone);
    int ticks = 0;
    while (bench.tick().busy && ++ticks < 3000) {
    }
    EXPECT_LT(ticks, 2500);
    for (int k = 0; k < 250; ++k) bench.tick();
    EXPECT_LT((bench.tip().p - goal.p).norm(), 2e-5);
    EXPECT_LT(Eigen::AngleAxisd(Matrix3(goal.R.transpose() * bench.tip().R)).angle(), 1e-3);
    EXPECT_LT((bench.out().wrist.R_RTip - bench.tip().R).norm(), 1e-6);
    const Vector3 p_R = bench.controller().X_BR().inverse() * bench.out().p_BTip;
    EXPECT_LT((p_R - bench.tip().p).norm(), 1e-6);
  }
}

TEST(Wrist, AVelocityOfTheTipIsFollowedInAllSixDirections) {
  for (int i = 0; i < 12; ++i) {
    const int axis = i % 6;
    WristBench bench(0.02, 0.02, WristBench::Drive::kSecond, i >= 6);
    const TipFrame before = bench.tip();
    MotionCommand command = test::command(Motion::kServoCv);
    if (axis < 3) command.p = 0.01 * Vector3::Unit(axis);
    if (axis >= 3) command.omega = 0.3 * Vector3::Unit(axis - 3);
    for (int k = 0; k < 500; ++k) ASSERT_EQ(bench.send(command), Reason::kNone);
    const TipFrame now = bench.tip();
    const Eigen::AngleAxisd turn(Matrix3(now.R * before.R.transpose()));
    const Vector3 turned = turn.angle() * turn.axis(), moved = now.p - before.p;
    if (axis < 3) {
      EXPECT_NEAR(moved[axis], 0.01, 8e-4);
      EXPECT_LT(turned.norm(), 0.01) << axis;
    } else {
      EXPECT_NEAR(turned[axis - 3], 0.3, 0.025);
      EXPECT_LT(moved.norm(), 5e-4) << axis;
    }
  }
}

TEST(Wrist, JointEndsAreRefusedOrSlidAlongNeverLeapt) {
  WristBench bench(0.04, 0.04);
  DriveJoints last = DriveJoints::Zero();
  bool refused = false;
  for (int k = 0; k < 1500; ++k) {  // the hand turns on to 2 rad
    TipFrame hand = hand_at(0);
    hand.R = Eigen::AngleAxisd(std::min(2.0, k * 0.002), Vector3::UnitX()).toRotationMatrix();
    refused = bench.servo_cp(hand) != Reason::kNone || refused;
    const DriveJoints now = bench.out().wrist.command;
    EXPECT_LT((now - last).cwiseAbs().maxCoeff(), 8 * kT + 1e-3) << k;
    EXPECT_LE(now.cwiseAbs().maxCoeff(), 1.396 + 1e-9);
    last = now;
  }
  EXPECT_TRUE(refused);
  WristBench sliding(0.04, 0.04);
  for (int k = 0; k < 1500; ++k) {
    const Eigen::Quaterniond turn(Eigen::AngleAxisd(std::min(2.0, k * 0.002), Vector3::UnitX()));
    const MotionCommand command = to_tip(Motion::kServoCp, hand_at(0).p, turn, true);
    ASSERT_EQ(sliding.send(command), Reason::kNone) << k;
  }
  EXPECT_GT(std::abs(sliding.in().wrist[1]), 1.39);
  EXPECT_LT((sliding.tip().p - hand_at(0).p).norm(), 1e-4) << "the tip keeps its place";
}

TEST(Wrist, TheTipKeepsItsPlaceWhileAJointMeetsItsEnd) {
  for (const double fast : {1.0, 2.5}) {  // [rad/s] of a hand that turns on to 2 rad and back
    WristBench bench(0.04, 0.04);
    double away = 0, most = 0;
    for (int k = 0; k < 2500; ++k) {
      const double t = k * kT, angle = std::min({fast * t, 2.0, 2.0 - fast * (t - 3)});
      const Eigen::Quaterniond turn(Eigen::AngleAxisd(std::max(0.0, angle), Vector3::UnitX()));
      const MotionCommand command = to_tip(Motion::kServoCp, hand_at(0).p, turn, true);
      if (k % 5 > 0) bench.tick();
      if (k % 5 == 0) ASSERT_EQ(bench.send(command), Reason::kNone) << k;
      away = std::max(away, (bench.tip().p - hand_at(0).p).norm());
      most = std::max(most, bench.out().wrist.set.cwiseAbs().maxCoeff());
    }
    std::cout << fast << " rad/s: tip " << 1e3 * away << " mm, joint " << most << " rad\n";
    EXPECT_LE(most, 1.396 + 1e-12);
    EXPECT_GT(most, 1.39) << "it met its end";
    EXPECT_LT(away, 1e-3);
  }
}

TEST(Wrist, AVelocityKeepsThePlaceOfTheTipWhereAJointEnds) {
  for (int axis = 0; axis < 2; ++axis) {
    WristBench bench(0.04, 0.04);
    const TipFrame before = bench.tip();
    MotionCommand command = test::command(Motion::kServoCv);
    command.omega = 0.8 * Vector3::Unit(axis);
    double away = 0, most = 0;
    for (int k = 0; k < 2000; ++k) {  // it asks for 3.2 rad
      ASSERT_EQ(bench.send(command), Reason::kNone) << k;
      away = std::max(away, (bench.tip().p - before.p).norm());
      most = std::max(most, bench.out().wrist.set.cwiseAbs().maxCoeff());
    }
    std::cout << "axis " << axis << ": tip " << 1e3 * away << " mm, joint " << most << " rad\n";
    EXPECT_GT(most, 1.38) << "it met its end";
    EXPECT_LE(most, 1.396 + 1e-12);
    EXPECT_LT(away, 2e-3);
  }
}

TEST(Wrist, AStreamNeverThrowsTheWrist) {
  TipFrame bent = hand_at(0);
  bent.R = Eigen::AngleAxisd(0.5, Vector3::UnitX()).toRotationMatrix();
  WristBench bench(0.04, 0.04);
  EXPECT_EQ(bench.servo_cp(bent), Reason::kStreamStartTooFar);
  for (int k = 0; k < 100; ++k) bench.tick();  // the stream falls silent
  for (int k = 0; k < 5; ++k) ASSERT_EQ(bench.servo_cp(hand_at(0)), Reason::kNone);
  EXPECT_EQ(bench.servo_cp(bent), Reason::kStepTooLarge);
}

/// Its centre and the roll stay, so that no other check sees it.
TEST(Wrist, AStreamNeverThrowsAWristThatTurnsInItsPlace) {
  for (int joint = 0; joint < 2; ++joint) {
    WristBench bench(0.04, 0.04);
    MotionCommand still = test::command(Motion::kServoJp);
    still.joints[2] = bench.out().depth;
    MotionCommand turned = still;
    turned.wrist[joint] = 0.5;
    EXPECT_EQ(bench.send(turned), Reason::kStreamStartTooFar);
    for (int k = 0; k < 100; ++k) bench.tick();  // the stream falls silent
    for (int k = 0; k < 5; ++k) ASSERT_EQ(bench.send(still), Reason::kNone);
    EXPECT_EQ(bench.send(turned), Reason::kStepTooLarge);
  }
}

TEST(Wrist, AHeldStreamStaysHeldWhileItAsksForWhatIsOutOfRange) {
  WristBench bench(0.04, 0.04);
  bench.servo_cp(hand_at(0));
  bench.send(test::command(Motion::kHold));
  TipFrame beyond = hand_at(0);
  beyond.R = Eigen::AngleAxisd(2.0, Vector3::UnitX()).toRotationMatrix();
  for (int k = 0; k < 100; ++k) EXPECT_EQ(bench.servo_cp(beyond), Reason::kHeld);
  EXPECT_EQ(bench.servo_cp(hand_at(0)), Reason::kHeld) << "it has never been silent";
}

TEST(Wrist, WhatIsNotFiniteIsAFault) {
  MotionCommand joints = test::command(Motion::kServoJv);
  joints.wrist[1] = NAN;
  MotionCommand twist = test::command(Motion::kServoCv);
  twist.omega[0] = INFINITY;
  for (const MotionCommand& command : {joints, twist}) {
    WristBench bench(0.04, 0.04);
    EXPECT_EQ(bench.send(command), Reason::kNotFinite);
    EXPECT_EQ(bench.out().state, State::kFault);
    for (int k = 0; k < 50; ++k) EXPECT_TRUE(bench.tick().wrist.command.allFinite());
  }
}

TEST(Wrist, EveryStopBringsTheDriveToRestWithinItsAcceleration) {
  enum class Stop { kHold, kSilence, kStateLost, kToolLost, kPause, kFault };
  for (const Stop stop : {Stop::kHold, Stop::kSilence, Stop::kStateLost, Stop::kToolLost,
                          Stop::kPause, Stop::kFault}) {
    WristBench bench(0.04, 0.04, WristBench::Drive::kSecond, true);
    for (int k = 0; k < 700; ++k) bench.servo_cp(hand_at(k * kT));
    const DriveJoints at = bench.out().wrist.command;
    if (stop == Stop::kHold) {
      bench.send(test::command(Motion::kHold));
    }
    if (stop == Stop::kPause) bench.controller().request(StateCommand::kPause);
    if (stop == Stop::kFault) bench.controller().fault(Reason::kForce);
    for (int k = 0; k < 200; ++k) {
      if (stop == Stop::kStateLost) bench.in().state_valid = false;
      if (stop == Stop::kToolLost) bench.in().jaw_age = 1;
      bench.tick();
    }
    const DriveJoints rest = bench.out().wrist.command;
    for (int k = 0; k < 100; ++k) bench.tick();
    EXPECT_EQ(bench.out().wrist.command, rest) << static_cast<int>(stop);
    EXPECT_LT((rest - at).cwiseAbs().maxCoeff(), stop == Stop::kSilence ? 0.4 : 0.15)
        << static_cast<int>(stop);
  }
}

TEST(Wrist, ADriveThatDoesNotFollowPausesTheArm) {
  WristBench bench(0.04, 0.04);
  for (int k = 0; k < 300; ++k) bench.servo_cp(hand_at(k * kT));
  bench.hold_drive();
  for (int k = 300; k < 1500 && bench.out().state == State::kEnabled; ++k) {
    bench.servo_cp(hand_at(k * kT));
  }
  EXPECT_EQ(bench.out().state, State::kPaused);
  EXPECT_EQ(bench.out().reason, Reason::kNotFollowing);
}

}  // namespace
}  // namespace surg
