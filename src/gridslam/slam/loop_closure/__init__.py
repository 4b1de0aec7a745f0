"""Loop closure: places recognized while the robot drives, and the constraints that follow."""
