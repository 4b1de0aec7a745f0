"""SLAM with landmarks: EKF SLAM, FastSLAM 1.0 and 2.0, GraphSLAM."""
