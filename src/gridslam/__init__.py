"""gridslam: 2D lidar SLAM with grid-based FastSLAM (GMapping) and its family."""

__version__ = "0.1.0"
