// A command for the next step of a controller under test.
#pragma once

#include <cstdint>

#include "surg_core/controller.hpp"

namespace surg::test {

/// Adds an empty command to the inputs; the caller fills it.
inline MotionCommand& next_command(Inputs& in, Motion motion, std::uint32_t source) {
  MotionCommand& command = in.commands[in.n_commands++];
  command = {};
  command.motion = motion;
  command.source = source;
  return command;
}

}  // namespace surg::test
