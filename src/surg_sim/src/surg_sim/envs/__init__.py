"""Tasks without ROS: Gymnasium environments, episodes, demonstrations, roll-outs."""
