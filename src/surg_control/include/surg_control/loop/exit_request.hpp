// Handles SIGTERM, SIGINT and ROS's shutdown request. By default the first kills at once and the
// other two close all topics before an arm could be stopped.
#pragma once

namespace surg_control {

/// Makes these three only set 'exit_requested', process-wide: the process then ends itself when its
/// arm is at rest. Needs a started ROS.
void hold_exit();
/// Whether the process was asked to end.
bool exit_requested();

}  // namespace surg_control
