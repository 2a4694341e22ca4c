#include "surg_core/state/robot_condition.hpp"

#include <cstddef>
#include <iterator>

namespace surg {

namespace {

/// By number.
constexpr const char* kSentences[] = {
    "the robot does not answer its link: check its power and its cable",
    "the robot is powered off: power it on and release its brakes",
    "the robot's brakes are on: release them",
    "the robot is not started: start it, then send 'enable'",
    "",
    "the robot is guided by hand: end the guiding and start the robot",
    "the robot moves slower than commanded: set its speed slider to 100 %, and slow it "
    "down by the cell's limits instead",
    "protective stop: look for its cause, unlock the robot and start it",
    "emergency stop: release the button, power the robot on, release its brakes and start "
    "it",
    "the robot reports an error: see its own display",
    "the link obeys another command than the controller sends: start both with the same "
    "kind",
};

}  // namespace

RobotCondition robot_condition(std::uint8_t number) {
  const bool known = number <= static_cast<std::uint8_t>(RobotCondition::kBroken);
  return known ? static_cast<RobotCondition>(number) : RobotCondition::kBroken;
}

const char* sentence(RobotCondition condition) {
  const auto number = static_cast<std::size_t>(condition);
  return number < std::size(kSentences) ? kSentences[number] : "unknown";
}

}  // namespace surg
