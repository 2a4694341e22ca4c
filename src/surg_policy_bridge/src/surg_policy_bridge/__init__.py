"""Model server and safety controller: the ROS side of a learned policy."""
