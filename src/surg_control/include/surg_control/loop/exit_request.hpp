// Handles SIGTERM, SIGINT and ROS's shutdown request. By default the first kills at once and the
// other two close all topics before an arm could be stopped.
#pragma once

namespace surg_control {

/// Makes these three only set 'exit_requested', process-wide. The process continues until
/// 'release_exit' has been called as often as this. Needs a started ROS.
void hold_exit();
/// Call it when an arm is at rest. The last call shuts ROS down if an exit was requested.
void release_exit();
/// Whether the process was asked to end.
bool exit_requested();

}  // namespace surg_control
