"""What both ways into ROS 2 share: its arguments and parameters."""
