"""What the tests share: a private ROS master, child processes that cannot outlive the run."""
