"""The ROS 2 package of gridslam: launch files, parameters and layouts."""
