// A controller closed over a plant it does not know, on a fake clock.
#pragma once

#include <gtest/gtest.h>

#include <deque>

#include "next_command.hpp"
#include "surg_core/controller.hpp"
#include "test_arm.hpp"

namespace surg::test {

constexpr double kT = 0.002;

/// The trocar may move.
inline Controller::Options tracking(bool may_move = true) {
  Controller::Options options;
  options.track_rcm = may_move;
  return options;
}

/// A controller, its arm and a fake clock. The plant integrates the commanded joint velocities
/// after 'delay' ticks through a first-order lag of 'tau' seconds (0: at once).
class Bench {
 public:
  explicit Bench(Controller::Options options = {}, int delay = 0, double tau = 0,
                 double link_lag = 0, const RobotConfig* robot = nullptr,
                 const ClearanceSetup& clearance = {})
      : robot_(robot ? *robot : robot_with_lag(link_lag)),
        chain_(test::ur5e_chain()),
        controller_(chain_, robot_, robot_.limits, test::instrument(), test::offset_tool(), options,
                    clearance),
        tau_(tau),
        pipeline_(delay, JointVector::Zero(6)) {
    in_.state_valid = true;
    in_.q = robot_.home;
    in_.qd = JointVector::Zero(6);
    const Pose X_BF = chain_.forward(in_.q);
    const ToolCalibration tool = test::offset_tool();
    const Vector3 s = X_BF.linear() * tool.s_F;
    controller_.set_rcm(X_BF * tool.p_FTip - 0.12 * s);
    tick();
    EXPECT_EQ(controller_.request(StateCommand::kHome), Reason::kNone);
    EXPECT_EQ(controller_.request(StateCommand::kEnable), Reason::kNone);
    tick();
  }

  const Outputs& tick() {
    out_ = &controller_.step(in_);
    in_.n_commands = 0;
    JointVector wanted = out_->qd_command;
    if (!pipeline_.empty()) {
      pipeline_.push_back(wanted);
      wanted = pipeline_.front();
      pipeline_.pop_front();
    }
    if (tau_ > 0) wanted = in_.qd + (1 - std::exp(-kT / tau_)) * (wanted - in_.qd);
    in_.qd = wanted;
    in_.q += kT * wanted;
    ++ticks;
    return *out_;
  }

  void send(const MotionCommand& command) { in_.commands[in_.n_commands++] = command; }
  /// Sends a command and runs a cycle; the answer, if it is the only one.
  Reason ask(const MotionCommand& command) {
    send(command);
    return tick().verdicts[0].reason;
  }

  /// A sample of the trocar, 'age' seconds old.
  void track(const Vector3& p, const Vector3& v, double age = 0) {
    in_.track_valid = true;
    in_.track_age = age;
    in_.p_BTrack = p;
    in_.v_BTrack = v;
  }

  void servo_cp(const Vector3& p_RTip, double roll = 0, std::uint32_t source = kMe) {
    send(pose(Motion::kServoCp, p_RTip, roll));
    in_.commands[in_.n_commands - 1].source = source;
  }

  MotionCommand pose(Motion motion, const Vector3& p_RTip, double roll = 0) const {
    return test::pose(controller_, motion, p_RTip, roll);
  }

  static RobotConfig robot_with_lag(double link_lag) {
    return test::robot_behind(test::good_robot(), link_lag);
  }

  Vector3 tip_in_R() const { return controller_.X_BR().inverse() * out_->p_BTip; }
  Controller& controller() { return controller_; }
  const Controller& controller() const { return controller_; }
  Inputs& in() { return in_; }
  const Outputs& out() const { return *out_; }
  const RobotConfig& robot() const { return robot_; }
  const Chain& chain() const { return chain_; }
  long ticks = 0;

 private:
  RobotConfig robot_;
  Chain chain_;
  Controller controller_;
  double tau_;
  std::deque<JointVector> pipeline_;
  Inputs in_;
  const Outputs* out_ = nullptr;
};

}  // namespace surg::test
