// The bundled UR5e with an ideal link round one ControlCycle.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "surg_control/loop/control_cycle.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {

/// The bundled UR5e with an ideal link, homed and ENABLED unless a test says otherwise.
class IdealArm {
 public:
  explicit IdealArm(bool track = false)
      : setup_(surg::load_arm(std::string(SURG_CELLS) + "/sim_ur5e", "")), model_(setup_.model) {
    surg::Controller::Options options;
    options.track_rcm = track;
    const surg::ControllerSetup made{model_.chain,        setup_.robot,
                                     setup_.limits,       setup_.mounted.instrument,
                                     setup_.mounted.tool, options};
    controller = std::make_unique<surg::Controller>(made.chain, made.robot, made.limits,
                                                    made.instrument, made.tool, made.options);
    box = std::make_unique<surg::BlackBox>(*controller, made);
    box->set_rcm(setup_.trocar.p_BRcm);
    cycle = std::make_unique<ControlCycle>(*controller, *box, "PSM1_rcm");
    link.q = setup_.robot.home;
    link.qd = surg::JointVector::Zero(link.q.size());
    link.jaw = 0.2;
    link.condition = surg::RobotCondition::kActive;
  }

  const CycleRecord& step(const std::vector<CommandItem>& items = {}) {
    now_ns += static_cast<std::int64_t>(kTickNs);
    link.stamp_ns = static_cast<std::uint64_t>(now_ns);
    link.received_ns = link.jaw_received_ns = now_ns;
    if (says_its_condition) link.condition_received_ns = now_ns;
    const CycleRecord& record = cycle->run(link, now_ns, 0, items.data(), items.size());
    link.qd = record.out.qd_command;
    link.q += link.qd * kTick;
    return record;
  }

  double link_timeout() const { return setup_.robot.tuning.link_timeout; }

  const CycleRecord& enable() {
    step();
    step({state(surg::StateCommand::kHome)});
    return step({state(surg::StateCommand::kEnable)});
  }

  static CommandItem state(surg::StateCommand command) {
    CommandItem item;
    item.kind = CommandItem::Kind::kState;
    item.source = 1;
    item.state = command;
    return item;
  }

  static CommandItem pose(surg::Motion motion, const ToolPose& at, const std::string& frame = "") {
    CommandItem item;
    item.source = 1;
    item.frame = FrameName(frame);
    item.motion.motion = motion;
    item.motion.p = at.p;
    item.motion.rotation = at.q;
    return item;
  }

  static CommandItem frame(const std::string& name, const surg::Pose& X_UR) {
    CommandItem item;
    item.kind = CommandItem::Kind::kSetFrame;
    item.source = 1;
    item.frame = FrameName(name);
    item.X_UR = X_UR;
    return item;
  }

  /// The measured tool in R.
  ToolPose tip() const {
    const CycleRecord& record = cycle->record();
    return {record.X_BR.inverse() * record.out.p_BTip, record.q_RTool};
  }

  std::unique_ptr<surg::Controller> controller;
  std::unique_ptr<surg::BlackBox> box;
  std::unique_ptr<ControlCycle> cycle;
  LinkState link;
  std::int64_t now_ns = 0;
  bool says_its_condition = true;

 private:
  surg::ArmSetup setup_;
  surg::Model model_;
};

}  // namespace surg_control
