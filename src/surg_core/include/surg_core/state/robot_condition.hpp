// What a robot link says of its robot (surg_msgs/LinkStatus.condition).
#pragma once

#include <cstdint>

namespace surg {

/// Numbered as in surg_msgs/LinkStatus. The controller moves the arm only while it is kActive.
enum class RobotCondition : std::uint8_t {
  kOffline = 0,       // the robot does not answer
  kOff = 1,           // powered off
  kBraked = 2,        // powered, the brakes are on
  kReady = 3,         // could move, but is not started
  kActive = 4,        // obeys its commands
  kGuided = 5,        // a person moves it by hand
  kSlowed = 6,        // obeys at a fraction of the speed
  kStopped = 7,       // protective stop or reflex
  kEstop = 8,         // emergency stop
  kBroken = 9,        // any other error
  kOtherCommand = 10  // its link obeys another command than the controller sends; on no wire
};

/// The condition with this number on the wire; kBroken for an unknown one.
RobotCondition robot_condition(std::uint8_t number);
/// One sentence for people where the link says none: what is wrong and what to do.
const char* sentence(RobotCondition condition);

}  // namespace surg
