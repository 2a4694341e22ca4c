// One control cycle without ROS: applies decoded commands to the controller, steps it once and
// keeps the record. The same code runs in lock-step, in the free-run thread and in a unit test.
#pragma once

#include <cstddef>

#include "surg_control/command_item.hpp"

namespace surg_control {

/// Drives one surg::Controller. Allocates nothing after construction.
class ControlCycle {
 public:
  explicit ControlCycle(surg::Controller& controller) : controller_(controller) {}

  /// State commands and taught trocars take effect first, then the controller steps with the motion
  /// commands in the order given. At most surg::kMaxCommands items; the caller keeps the rest.
  /// 'state_age' [s] is 0 in lock-step. tick, timing and refused_by_node of the record are the
  /// caller's.
  const CycleRecord& run(const LinkState& link, double state_age, const CommandItem* items,
                         std::size_t count);

  CycleRecord& record() { return record_; }

 private:
  void answer(const CommandItem& item);
  Eigen::Quaterniond orientation_at(const surg::Vector3& p_B, double roll) const;

  surg::Controller& controller_;
  surg::Inputs inputs_;
  CycleRecord record_;
};

}  // namespace surg_control
