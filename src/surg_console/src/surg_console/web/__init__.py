"""The browser's side of the console: server, page and pictures. No ROS."""
