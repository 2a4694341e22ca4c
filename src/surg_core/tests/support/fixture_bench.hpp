// An arm behind the controller for the tests of virtual fixtures, with distances of its own.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "controller_bench.hpp"
#include "lagging_arm.hpp"
#include "next_command.hpp"
#include "surg_core/controller.hpp"
#include "test_arm.hpp"

namespace surg::test {

/// Least value of a convex function of 0..1, by ternary search.
template <typename Function>
double least(Function at) {
  double from = 0, to = 1;
  for (int i = 0; i < 50; ++i) {
    const double third = (to - from) / 3;
    if (at(from + third) < at(to - third)) {
      to -= third;
    } else {
      from += third;
    }
  }
  return at(0.5 * (from + to));
}

/// Distance of a point from a region's surface, negative inside. Independent of the code
/// under test.
inline double outside_region(const Fixture& f, const Vector3& p) {
  if (f.shape == Fixture::Shape::kPlane) return -(p - f.point).dot(f.axis);
  if (f.shape == Fixture::Shape::kSphere) return (p - f.point).norm() - f.radius;
  return least([&](double share) { return (p - (f.point + share * f.axis)).norm(); }) - f.radius;
}

/// How far a tip, or a shaft from the trocar to it, is on the allowed side; negative: beyond.
inline double allowed_by(const Fixture& f, const Vector3& p_Tip, const Vector3& p_Rcm) {
  if (f.of == Fixture::Of::kTip) {
    const double out = outside_region(f, p_Tip);
    return f.side == Fixture::Side::kKeepOut ? out : -out;
  }
  return least([&](double share) { return outside_region(f, p_Rcm + share * (p_Tip - p_Rcm)); });
}

inline Fixture fixture(const char* name, Fixture::Shape shape, Fixture::Side side,
                       const Vector3& point, const Vector3& axis, double radius) {
  Fixture f;
  f.set_name(name);
  f.shape = shape;
  f.side = side;
  f.point = point;
  f.axis = axis;
  f.radius = radius;
  return f;
}

/// A lagging UR5e or Panda as shipped, ENABLED with 120 mm of its shaft behind the trocar.
class FixtureBench {
 public:
  FixtureBench(bool panda, unsigned seed, double shortest_lag = 0.008, double longest_lag = 0.012)
      : random(seed),
        robot_(robot_of(panda)),
        chain_(panda ? panda_chain() : ur5e_chain()),
        controller_(chain_, robot_, robot_.limits, instrument(), offset_tool(), {}),
        arm_(robot_.home, random, shortest_lag, longest_lag),
        last_(JointVector::Zero(chain_.dof())) {
    in_.state_valid = true;
    const Pose X_BF = chain_.forward(arm_.truth());
    const ToolCalibration tool = offset_tool();
    p_BRcm_ = X_BF * tool.p_FTip - 0.12 * (X_BF.linear() * tool.s_F);
    controller_.set_rcm(p_BRcm_);
    in_.q = arm_.measured();
    tick();
    EXPECT_EQ(controller_.request(StateCommand::kHome), Reason::kNone);
    EXPECT_EQ(controller_.request(StateCommand::kEnable), Reason::kNone);
    tick();
  }

  const Outputs& tick() {
    const JointVector q = arm_.measured();
    in_.qd = ticks == 0 ? JointVector::Zero(q.size()) : JointVector((q - in_.q) / kT);
    in_.q = q;
    out_ = &controller_.step(in_);
    in_.n_commands = 0;
    const JointVector change = (out_->qd_command - last_) / kT;
    hardest = std::max(hardest, (change.array() / robot_.acceleration.array()).abs().maxCoeff());
    last_ = out_->qd_command;
    const Vector3 before = tip();
    arm_.obey(out_->qd_command);
    off_pivot = std::max(off_pivot, off_shaft(chain_, arm_.truth(), offset_tool(), p_BRcm_));
    for (const Fixture& f : controller_.fixtures()) {
      deepest = std::max(deepest, -allowed_by(f, tip(), p_BRcm_));
      deepest_set = std::max(deepest_set, -allowed_by(f, out_->p_set, p_BRcm_));
    }
    fastest = std::max(fastest, (tip() - before).norm() / kT);
    ++ticks;
    return *out_;
  }

  MotionCommand& send(Motion motion) { return next_command(in_, motion); }
  void servo_cp(const Vector3& p_R) { pose(Motion::kServoCp, p_R); }
  void pose(Motion motion, const Vector3& p_R) {
    send(motion) = test::pose(controller_, motion, p_R);
  }
  void servo_cv(const Vector3& v_R) { send(Motion::kServoCv).p = v_R; }

  /// A region given in the rcm frame.
  Reason put(Fixture f) {
    f.point = controller_.X_BR() * f.point;
    f.axis = controller_.X_BR().linear() * f.axis;
    return controller_.set_fixture(f);
  }

  Vector3 tip() const { return chain_.forward(arm_.truth()) * offset_tool().p_FTip; }
  Vector3 tip_R() const { return controller_.X_BR().inverse() * tip(); }
  Vector3 set_R() const { return controller_.X_BR().inverse() * out_->p_set; }
  void forget() { hardest = off_pivot = deepest = deepest_set = fastest = 0; }

  Controller& controller() { return controller_; }
  const Inputs& in() const { return in_; }
  const Outputs& out() const { return *out_; }
  const RobotConfig& robot() const { return robot_; }

  Random random;
  long ticks = 0;
  double hardest = 0;                   ///< joint acceleration commanded, over its limit
  double off_pivot = 0;                 ///< [m]
  double deepest = 0, deepest_set = 0;  ///< [m] of arm and set-point beyond a wall
  double fastest = 0;                   ///< [m/s]

 private:
  static RobotConfig robot_of(bool panda) {
    Document d = good_robot();
    d.values["tuning.rcm_gain"] = 50.0;
    d.values["limits.tip_jerk"] = 100.0;
    const JointVector home = panda ? panda_home() : ur5e_home();
    d.values["joints.home"] = std::vector<double>(home.data(), home.data() + home.size());
    d.values["joints.acceleration"] = std::vector<double>(6, 40.0);
    if (panda) {
      const JointVector v = panda_velocity(), a = panda_acceleration();
      d.values["joints.names"] = std::vector<std::string>{"a", "b", "c", "d", "e", "f", "g"};
      d.values["joints.velocity"] = std::vector<double>(v.data(), v.data() + 7);
      d.values["joints.acceleration"] = std::vector<double>(a.data(), a.data() + 7);
      d.values["joints.position_min"] = std::vector<double>(7, -3.0);
      d.values["joints.position_max"] = std::vector<double>(7, 3.0);
      d.values["limits.tip_acceleration"] = 0.6;
      d.values["limits.pivot_acceleration"] = 5.0;
      d.values["limits.roll_velocity"] = 2.0;
      d.values["limits.roll_acceleration"] = 8.0;
      d.values["limits.roll_jerk"] = 250.0;
      d.values["tuning.stream_delay"] = 0.008;
    }
    return robot_behind(d, 0.01);
  }

  RobotConfig robot_;
  Chain chain_;
  Controller controller_;
  LaggingArm arm_;
  Vector3 p_BRcm_;
  Inputs in_;
  JointVector last_;
  const Outputs* out_ = nullptr;
};

}  // namespace surg::test
