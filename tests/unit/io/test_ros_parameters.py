"""Parameter files of ROS: nodes, nested names, and keys that YAML 1.1 would take for booleans."""

from __future__ import annotations

from gridslam.io.ros_parameters import read_parameter_file
from gridslam.io.yaml import parse_yaml


def test_keys_are_texts_and_values_are_not():
    """To YAML 1.1 the coordinate y is true: an initial pose lost it."""
    assert parse_yaml("{x: 1, y: 2, no: y, 3: 4}") == {"x": 1, "y": 2, "no": True, "3": 4}
    assert parse_yaml("a: &a {y: 1}\nb: {<<: *a, z: on}") == {"a": {"y": 1}, "b": {"y": 1, "z": True}}


def test_nodes_and_nested_names(tmp_path):
    (tmp_path / "ros2.yaml").write_text(
        "/robot1:\n  amcl:\n    ros__parameters:\n"
        "      initial_pose: {x: 1, y: 2}\n      qos_overrides: {/scan: {depth: 5}}\n"
        "/**: {ros__parameters: {use_sim_time: yes}}\n"
    )
    assert read_parameter_file(tmp_path / "ros2.yaml") == [
        ("/robot1/amcl", {"initial_pose.x": 1, "initial_pose.y": 2}),
        ("/**", {"use_sim_time": True}),
    ]
    (tmp_path / "ros1.yaml").write_text("max_particles: 500\nkld: {err: 0.1}\n")
    assert read_parameter_file(tmp_path / "ros1.yaml") == [("", {"max_particles": 500, "kld.err": 0.1})]
