// A controller in front of an arm that lives in its own time: cycles may come late, commands may be
// lost, and the link stops the arm by itself when it hears nothing. Judged by the arm's own motion.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <utility>

#include "controller_bench.hpp"
#include "next_command.hpp"
#include "surg_core/controller.hpp"
#include "test_arm.hpp"

namespace surg::test {

/// An arm and its link. The command of a cycle takes effect 'delay' later and through a first-order
/// lag; without a new command for 'dead_man' the link ramps the arm to rest.
struct Plant {
  double delay = 0, lag = 0;   ///< [s]
  double dead_man = INFINITY;  ///< [s]
};

class TimedArm {
 public:
  static constexpr double kStep = 0.001;  ///< [s]

  TimedArm(const Plant& plant, const JointVector& q, const JointVector& acceleration)
      : plant_(plant), acceleration_(acceleration), q_(q) {
    qd_.setZero(q.size());
    command_ = obeyed_ = qd_;
    recent_.assign(std::lround(kT / kStep), qd_);
  }

  /// The link gets it after the delay.
  void obey(const JointVector& command) { on_its_way_.push_back({plant_.delay, command}); }

  /// One step of the arm's own time.
  void advance() {
    silent_ += kStep;
    for (auto& [left, command] : on_its_way_) left -= kStep;
    while (!on_its_way_.empty() && on_its_way_.front().first < -kStep / 2) {
      command_ = on_its_way_.front().second;
      silent_ = 0;
      on_its_way_.pop_front();
    }
    JointVector wanted = command_;
    stopped_ = silent_ > plant_.dead_man + kStep / 2;
    if (stopped_) {  // a ramp of its own, inside the arm's acceleration
      const JointVector most = acceleration_ * kStep;
      wanted = obeyed_ - obeyed_.cwiseMax(-most).cwiseMin(most);
    }
    obeyed_ = wanted;
    if (plant_.lag > 0) wanted = qd_ + (1 - std::exp(-kStep / plant_.lag)) * (wanted - qd_);
    q_ += kStep * wanted;
    qd_ = wanted;
    recent_.push_back(qd_);
    const JointVector change = (qd_ - recent_.front()) / kT;
    recent_.pop_front();
    worst_ = std::max(worst_, (change.array() / acceleration_.array()).abs().maxCoeff());
  }

  const JointVector& q() const { return q_; }
  const JointVector& qd() const { return qd_; }
  /// Whether the link has stopped listening.
  bool stopped() const { return stopped_; }
  /// Largest change of the arm's velocity within one control period, over the acceleration limit.
  double worst_acceleration() const { return worst_; }
  void forget() { worst_ = 0; }

 private:
  Plant plant_;
  JointVector acceleration_, q_, qd_, command_, obeyed_;
  std::deque<JointVector> recent_;
  std::deque<std::pair<double, JointVector>> on_its_way_;  // [s] until it arrives
  double silent_ = 0, worst_ = 0;
  bool stopped_ = false;
};

class TimedBench {
 public:
  explicit TimedBench(Law law = Law::kExact, const Plant& plant = {}, double link_lag = 0,
                      double acceleration = 15, double off_shaft = 0)
      : robot_(robot_with(link_lag, acceleration)),
        chain_(ur5e_chain()),
        controller_(chain_, robot_, robot_.limits, instrument(), offset_tool(), {law}),
        arm_(plant, robot_.home, robot_.acceleration) {
    const ToolCalibration tool = offset_tool();
    const Pose X_BF = chain_.forward(arm_.q());
    p_BRcm_ = X_BF * tool.p_FTip - 0.12 * (X_BF.linear() * tool.s_F);
    p_BRcm_ += off_shaft * X_BF.linear().col(0);
    controller_.set_rcm(p_BRcm_);
    cycle();
    EXPECT_EQ(controller_.request(StateCommand::kHome), Reason::kNone);
    EXPECT_EQ(controller_.request(StateCommand::kEnable), Reason::kNone);
    cycle();
  }

  /// One cycle, 'period' [s] after the one before. lost: its command does not reach the link.
  const Outputs& cycle(double period = kT, bool lost = false) {
    for (int i = 0; i < std::lround(period / TimedArm::kStep); ++i) {
      arm_.advance();
      off_pivot_ = deviation();
      worst_pivot_ = std::max(worst_pivot_, off_pivot_);
      time_ += TimedArm::kStep;
    }
    in_.state_valid = true;
    states_.push_front({arm_.q(), arm_.qd()});
    if (states_.size() > states_late_ + 1) states_.resize(states_late_ + 1);
    in_.q = states_.back().first;
    in_.qd = states_.back().second;
    in_.state_age = static_cast<double>(states_.size() - 1) * period;
    in_.elapsed = period;
    out_ = &controller_.step(in_);
    in_.n_commands = 0;
    if (!lost && !out_->withheld) arm_.obey(out_->qd_command);
    return *out_;
  }

  MotionCommand& send(Motion motion) { return next_command(in_, motion); }
  void servo_cv(const Vector3& v) { send(Motion::kServoCv).p = v; }
  MotionCommand& servo_cp(const Vector3& p_RTip) {
    return send(Motion::kServoCp) = pose(controller_, Motion::kServoCp, p_RTip);
  }
  /// From now on states take that many cycles to arrive.
  void delay_states(std::size_t cycles) { states_late_ = cycles; }
  /// Straight on at 'v' [m/s] along x for a while.
  void in_motion(double v = 0.1, double seconds = 0.3) {
    for (int i = 0; i < std::lround(seconds / kT); ++i) {
      servo_cv(Vector3(v, 0, 0));
      cycle();
    }
  }

  /// Distance of the true shaft from the trocar [m].
  double deviation() const { return off_shaft(chain_, arm_.q(), offset_tool(), p_BRcm_); }
  double worst_pivot() const { return worst_pivot_; }
  double time() const { return time_; }
  void forget() {
    worst_pivot_ = 0;
    arm_.forget();
  }

  Controller& controller() { return controller_; }
  TimedArm& arm() { return arm_; }
  Inputs& in() { return in_; }
  const Outputs& out() const { return *out_; }
  const RobotConfig& robot() const { return robot_; }
  const Vector3& p_BRcm() const { return p_BRcm_; }

 private:
  static RobotConfig robot_with(double link_lag, double acceleration) {
    Document document = good_robot();
    document.values["tuning.rcm_gain"] = 50.0;  // as shipped
    document.values["joints.acceleration"] = std::vector<double>(6, acceleration);
    return robot_behind(document, link_lag);
  }

  RobotConfig robot_;
  Chain chain_;
  Controller controller_;
  TimedArm arm_;
  Vector3 p_BRcm_;
  Inputs in_;
  const Outputs* out_ = nullptr;
  std::deque<std::pair<JointVector, JointVector>> states_;  // the newest first
  std::size_t states_late_ = 0;
  double worst_pivot_ = 0, off_pivot_ = 0, time_ = 0;
};

}  // namespace surg::test
