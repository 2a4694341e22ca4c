"""Running ROS graphs: which nodes, started how, watched how."""
