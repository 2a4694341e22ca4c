"""The model server without ROS: sessions, safety controller, play-out."""
