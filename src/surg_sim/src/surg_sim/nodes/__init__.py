"""The ROS nodes of the simulator, and the pure parts that only they need."""
