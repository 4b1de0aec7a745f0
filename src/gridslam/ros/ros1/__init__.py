"""The node in ROS 1."""
