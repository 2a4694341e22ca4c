// The ways a process is asked to end: SIGTERM, SIGINT and ROS's own shutdown request. By default
// the first kills at once, and the other two close every topic before an arm could be stopped.
#pragma once

namespace surg_control {

/// From now on these three only set 'exit_requested', process-wide, and the process goes on until
/// 'release_exit' has been called as often as this. Needs a started ROS.
void hold_exit();
/// One arm has come to rest. The last one ends ROS, if that was asked for.
void release_exit();
/// Whether the process was asked to end.
bool exit_requested();

}  // namespace surg_control
