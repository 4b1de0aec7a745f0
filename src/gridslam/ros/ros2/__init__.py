"""The node in ROS 2, by rclpy or by DDS."""
