"""Who is in control, and what pages are told. No ROS, no sockets."""
