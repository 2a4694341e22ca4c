#include "surg_core/state/robot_condition.hpp"

namespace surg {

RobotCondition robot_condition(std::uint8_t number) {
  const bool known = number <= static_cast<std::uint8_t>(RobotCondition::kBroken);
  return known ? static_cast<RobotCondition>(number) : RobotCondition::kBroken;
}

const char* sentence(RobotCondition condition) {
  switch (condition) {
    case RobotCondition::kOffline:
      return "the robot does not answer its link: check its power and its cable";
    case RobotCondition::kOff:
      return "the robot is powered off: power it on and release its brakes";
    case RobotCondition::kBraked:
      return "the robot's brakes are on: release them";
    case RobotCondition::kReady:
      return "the robot is not started: start it, then send 'enable'";
    case RobotCondition::kActive:
      return "";
    case RobotCondition::kGuided:
      return "the robot is guided by hand: end the guiding and start the robot";
    case RobotCondition::kSlowed:
      return "the robot moves slower than commanded: set its speed slider to 100 %, and slow it "
             "down by the cell's limits instead";
    case RobotCondition::kStopped:
      return "protective stop: look for its cause, unlock the robot and start it";
    case RobotCondition::kEstop:
      return "emergency stop: release the button, power the robot on, release its brakes and start "
             "it";
    case RobotCondition::kBroken:
      return "the robot reports an error: see its own display";
    case RobotCondition::kOtherCommand:
      return "the link obeys another command than the controller sends: start both with the same "
             "kind";
  }
  return "unknown";
}

}  // namespace surg
