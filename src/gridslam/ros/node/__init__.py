"""The node of ROS, for any transport of messages."""
