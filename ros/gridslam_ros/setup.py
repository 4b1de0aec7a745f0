"""The package as colcon builds it; gridslam itself is installed by pip."""

from pathlib import Path

from setuptools import setup

NAME = "gridslam_ros"
FOLDERS = "launch", "config", "rviz", "foxglove"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *((f"share/{NAME}/{folder}", sorted(map(str, Path(folder).iterdir()))) for folder in FOLDERS),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The gridslam developers",
    maintainer_email="gridslam@example.org",
    description="Launch files, parameters and layouts for the ROS 2 node of gridslam.",
    license="BSD-3-Clause",
    entry_points={"console_scripts": [f"node = {NAME}.node:main"]},
)
