"""The node in ROS 2 by rclpy."""
