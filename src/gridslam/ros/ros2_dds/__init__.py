"""The node in ROS 2 by its own RTPS."""
