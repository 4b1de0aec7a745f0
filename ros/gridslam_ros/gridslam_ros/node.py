"""The executable `ros2 run gridslam_ros node`: the command `gridslam ros2`."""

import sys


def main() -> None:
    """Run the node with the arguments of ROS; exits with the command's status."""
    try:
        from gridslam.cli.main import main as command
    except ImportError as error:
        sys.exit(f"gridslam is not installed for {sys.executable} ({error}): see docs/ros.md of gridslam")
    sys.argv = ["gridslam", "ros2", *sys.argv[1:]]
    command()


if __name__ == "__main__":
    main()
