"""The ROS side of the model server: topics, socket, and the two loops."""
