#include "surg_control/control_cycle.hpp"

#include <chrono>

namespace surg_control {

void ControlCycle::answer(const CommandItem& item) {
  Answer& answer = record_.answers[record_.n_answers++];
  answer.kind = item.kind;
  answer.state = item.state;
  answer.source = item.source;
  answer.reason = item.kind == CommandItem::Kind::kState ? controller_.request(item.state)
                                                         : controller_.set_rcm(item.p_BRcm);
}

/// The shaft through the pivot and a point has one direction; the tip cannot be on the pivot
/// itself, where the measured axis stands in.
Eigen::Quaterniond ControlCycle::orientation_at(const surg::Vector3& p_B, double roll) const {
  const surg::Vector3 along = p_B - record_.out.p_BRcm;
  const double length = along.norm();
  const surg::Vector3 s_B = length > 1e-6 ? surg::Vector3(along / length) : record_.out.s_B;
  return controller_.tool_orientation(s_B, roll);
}

const CycleRecord& ControlCycle::run(const LinkState& link, double state_age,
                                     const CommandItem* items, std::size_t count) {
  record_.n_answers = 0;
  inputs_.n_commands = 0;
  const std::size_t taken = std::min<std::size_t>(count, surg::kMaxCommands);
  for (std::size_t i = 0; i < taken; ++i) {
    if (items[i].kind != CommandItem::Kind::kMotion) {
      answer(items[i]);
      continue;
    }
    surg::MotionCommand& motion = inputs_.commands[inputs_.n_commands++];
    motion = items[i].motion;
    motion.source = items[i].source;
    if (motion.motion == surg::Motion::kServoCv) {
      // Shaft of the last cycle, 2 ms old: the axis turns by less than 0.5 degrees in that time.
      motion.roll_rate = items[i].angular.dot(record_.X_BR.linear().transpose() * record_.out.s_B);
    }
  }
  inputs_.state_valid = link.stamp_ns != 0;
  inputs_.state_age = state_age;
  inputs_.q = link.q;
  inputs_.qd = link.qd;
  inputs_.jaw = link.jaw;

  const auto start = std::chrono::steady_clock::now();
  const surg::Outputs& out = controller_.step(inputs_);
  const auto end = std::chrono::steady_clock::now();

  record_.stamp_ns = link.stamp_ns;
  record_.q = link.q;
  record_.qd = link.qd;
  record_.out = out;
  record_.X_BR = controller_.X_BR();
  record_.q_RTool = controller_.tool_orientation(out.s_B, out.roll);
  record_.q_RSet = orientation_at(out.p_set, out.roll_set);
  record_.q_RGoal = orientation_at(out.p_goal, out.roll_goal);
  record_.compute_us = std::chrono::duration<double, std::micro>(end - start).count();
  return record_;
}

}  // namespace surg_control
