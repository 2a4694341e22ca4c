"""The console's ROS nodes."""
