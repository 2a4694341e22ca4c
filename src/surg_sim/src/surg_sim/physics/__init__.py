"""The world: arms, trocars, tissue, tools and faults in MuJoCo. No ROS, no clock."""
