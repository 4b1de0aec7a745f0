"""Which topics and frames of a bag are taken, and when the user must say it."""

from __future__ import annotations

import math

import pytest

from gridslam.errors import InputError
from gridslam.io.bags.bag import BagLog
from gridslam.io.log import LogOptions
from support import ros_bags
from support.ros_bags import drive, odometry, scan, transform

FOUR = [1.0, 2.0, 3.0, 4.0]


def choice_of(folder, said, **options):
    path = ros_bags.write(folder, "ros1", sorted(said, key=lambda each: each.time_ns))
    return BagLog(path, LogOptions(**options)).choice


def refused(folder, said, **options):
    with pytest.raises(InputError) as caught:
        choice_of(folder, said, **options)
    return str(caught.value)


def robot(name):
    said = [transform(0.0, f"{name}/base_link", f"{name}/laser", (0.1, 0, 0))]
    for step in range(5):
        said.append(odometry(f"/{name}/odom", step / 10, (0, 0, 0), frames=(f"{name}/odom", f"{name}/base_link")))
        said.append(scan(f"/{name}/scan", 0.05 + step / 10, FOUR, frame=f"{name}/laser"))
    return said


def test_several_robots_must_be_told_apart(tmp_path):
    both = [*robot("r1"), *robot("r2")]
    said = refused(tmp_path, both)
    assert "several robots" in said
    assert "choose with --scan TOPIC among /r1/scan, /r2/scan" in said
    (tmp_path / "log.bag").unlink()
    chosen = choice_of(tmp_path, both, scan_topics=("/r2/scan",))
    assert (chosen.odometry, chosen.base_frame) == ("/r2/odom", "r2/base_link")


def test_lasers_in_several_namespaces_without_transforms_may_be_of_several_robots(tmp_path):
    said = [scan("/a/scan", 0.0, FOUR, frame="a"), scan("/b/scan", 0.0, FOUR, frame="b")]
    assert "maybe of several robots" in refused(tmp_path, said)


def test_lasers_of_one_robot_in_several_namespaces(tmp_path):
    links = [transform(0.0, "base_link", frame, (x, 0, 0)) for frame, x in (("a", 0.2), ("b", -0.2))]
    said = [*links, scan("/a/scan", 0.0, FOUR, frame="a"), scan("/b/scan", 0.0, FOUR, frame="b")]
    assert choice_of(tmp_path, said).scans == ("/a/scan", "/b/scan")


def test_several_lasers_whose_places_are_not_told(tmp_path):
    said = [scan("/scan_a", 0.0, FOUR, frame="a"), scan("/scan_b", 0.0, FOUR, frame="b")]
    assert "the mounting of /scan_a (a) is unknown" in refused(tmp_path, said)


MOUNTED = [transform(0.0, "base_link", "laser")]


@pytest.mark.parametrize("links", [MOUNTED, []])
@pytest.mark.parametrize(
    ("counts", "taken"),
    [
        ({"/scan": 1, "/scan_filtered": 3}, "/scan"),
        ({"/r/scan": 1, "/r/a_scan": 3}, "/r/scan"),
        ({"/a_scan": 1, "/b_scan": 3, "/c_scan": 2}, "/b_scan"),
        ({"/a_scan": 2, "/b_scan": 2}, "/a_scan"),
    ],
)
def test_of_several_topics_of_one_laser_one_is_taken_and_the_others_are_named(tmp_path, counts, taken, links):
    said = [*links, *(scan(name, 0.1 * k, FOUR) for name, count in counts.items() for k in range(count))]
    chosen = choice_of(tmp_path, said)
    others = ", ".join(name for name in counts if name != taken)
    assert chosen.scans == (taken,)
    assert chosen.remarks == (f"{others} left out: scans of the same laser (laser) as {taken} (--scan TOPIC takes it)",)
    (tmp_path / "log.bag").unlink()
    other = min(set(counts) - {taken})
    assert choice_of(tmp_path, said, scan_topics=(other,)).scans == (other,)


def test_each_of_two_lasers_with_two_topics_is_read_once(tmp_path):
    links = [transform(0.0, "base_link", frame, (x, 0, 0)) for frame, x in (("a", 0.2), ("b", -0.2))]
    said = [scan(f"/{frame}{kind}", 0.0, FOUR, frame=frame) for frame in "ab" for kind in ("/scan", "_filtered")]
    chosen = choice_of(tmp_path, [*links, *said])
    assert chosen.scans == ("/a/scan", "/b/scan")
    assert len(chosen.remarks) == 2


@pytest.mark.parametrize(
    ("first", "second", "problem"),
    [
        (("/a/scan", "laser"), ("/b/scan", "laser"), "maybe of several robots"),
        (("/scan_a", ""), ("/scan_b", ""), "the mounting of /scan_a () is unknown"),
    ],
)
def test_topics_that_may_be_of_different_lasers_are_not_taken_for_one(tmp_path, first, second, problem):
    said = [scan(name, 0.0, FOUR, frame=frame) for name, frame in (first, second)]
    assert problem in refused(tmp_path, said)


def test_a_laser_that_tilts_beside_one_that_does_not_is_left_out(tmp_path):
    said = [transform(0.0, "base_link", "fixed"), scan("/scan", 0.5, FOUR, frame="fixed")]
    for step in range(9):
        turn = (0.0, math.sin(0.1 * step), 0.0, math.cos(0.1 * step))
        said.append(transform(0.1 * step, "base_link", "tilting", xyzw=turn, topic="/tf"))
        said.append(scan("/tilt_scan", 0.1 * step, FOUR, frame="tilting"))
    chosen = choice_of(tmp_path, said)
    assert chosen.scans == ("/scan",)
    assert any("/tilt_scan left out" in remark for remark in chosen.remarks)


def test_without_scans_the_topics_are_listed(tmp_path):
    said = refused(tmp_path, drive(scans=False))
    assert "/odom (nav_msgs/Odometry), /tf_static (tf2_msgs/TFMessage)" in said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scan_topics": ("/laser",)}, "expected scans on /laser, got scans on /scan alone"),
        ({"odometry_topic": "/scan"}, "on /scan; topics of it: /odom"),
        ({"odometry_frame": "somewhere"}, "no transform joins the frames somewhere and base_link"),
        ({"base_frame": "nowhere"}, "no transform joins the frames nowhere and base_link"),
    ],
)
def test_names_that_are_not_there(tmp_path, options, message):
    assert message in refused(tmp_path, drive(), **options)


def moving(topic, scale=1.0, frames=("odom", "base_link")):
    return [odometry(topic, step / 20, (scale * step / 20, 0, 0), frames=frames) for step in range(41)]


def test_ground_truth_is_not_taken(tmp_path):
    said = [*drive(), *moving("/base_pose_ground_truth")]
    chosen = choice_of(tmp_path, said)
    assert chosen.odometry == "/odom"
    assert any("/base_pose_ground_truth not used" in remark for remark in chosen.remarks)


def test_ground_truth_alone_is_no_odometry_unless_it_is_named(tmp_path):
    said = [scan("/scan", 1.0, FOUR), *moving("/gt")]
    assert choice_of(tmp_path, said).odometry_frame == ""
    (tmp_path / "log.bag").unlink()
    assert choice_of(tmp_path, said, odometry_topic="gt").odometry == "/gt"


def test_of_several_odometries_the_one_of_the_transforms_is_taken(tmp_path):
    links = [transform(step / 20, "odom", "base_link", (0.9 * step / 20, 0, 0), topic="/tf") for step in range(41)]
    said = [*moving("/odom"), *moving("/odom_fused", 0.9), *links, transform(0.0, "base_link", "laser")]
    said.append(scan("/scan", 1.0, FOUR))
    assert choice_of(tmp_path, said).odometry == "/odom_fused"


def test_several_odometries_and_no_transform_to_tell(tmp_path):
    said = [*moving("/odom"), *moving("/odom_fused", 0.9), scan("/scan", 1.0, FOUR)]
    assert "choose with --odom TOPIC among /odom, /odom_fused" in refused(tmp_path, said)
    (tmp_path / "log.bag").unlink()
    assert choice_of(tmp_path, said, odometry_topic="/odom").odometry == "/odom"


def test_frames_that_are_asked_for_go_ahead_of_a_topic(tmp_path):
    links = [transform(step / 20, "odom", "base_link", (step / 20, 0, 0), topic="/tf") for step in range(41)]
    chosen = choice_of(tmp_path, [*drive(), *links], odometry_frame="odom")
    assert (chosen.odometry, chosen.odometry_frame, chosen.base_frame) == ("", "odom", "base_link")


def test_an_odometry_that_does_not_say_whose_pose_it_is(tmp_path):
    said = [*moving("/odom", frames=("odom", "")), transform(0.0, "body", "laser", (0.1, 0, 0))]
    chosen = choice_of(tmp_path, [*said, scan("/scan", 1.0, FOUR)])
    assert (chosen.odometry_child, chosen.base_frame) == ("body", "body")
    assert any("has the child frame no frame" in remark for remark in chosen.remarks)


def test_another_base_frame(tmp_path):
    said = [*drive(), transform(0.0, "base_link", "axle", (-0.3, 0, 0))]
    path = ros_bags.write(tmp_path, "mcap", sorted(said, key=lambda each: each.time_ns))
    log = BagLog(path, LogOptions(base_frame="/axle"))
    odo, laser = next(iter(log))
    assert odo.pose[0] == pytest.approx(0.06 - 0.3, abs=1e-4)  # turned by 0.006 rad
    assert laser.geometry.origin[0] == pytest.approx(0.5)


def test_a_chain_with_a_hole_is_told(tmp_path):
    said = [
        *moving("/odom", frames=("odom", "base_footprint")),
        transform(0.0, "odom", "base_footprint", topic="/tf"),
        transform(0.0, "base_link", "laser"),
        scan("/scan", 1.0, FOUR),
    ]
    message = refused(tmp_path, said)
    assert "no transform joins the frames base_footprint and laser" in message
    assert "odom <- base_footprint and base_link <- laser" in message


def scans(count=4, **fields):
    return [scan("/scan", step / 10, FOUR, **fields) for step in range(count)]


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        (
            {"angles": (-1.0, 0.25), "angle_max": 0.6},
            "angle_min -1 in steps of angle_increment 0.25 rad, which end at -0.25 rad, not at angle_max 0.6",
        ),
        ({"angles": (-90.0, 60.0)}, "look like degrees"),
        ({"angles": (-1.0, 0.0), "angle_max": 1.0}, "all point one way"),
    ],
)
def test_angles_that_no_map_can_be_made_of_are_refused_with_all_numbers(tmp_path, fields, problem):
    said = refused(tmp_path, scans(**fields))
    assert "the scans of /scan" in said
    assert problem in said


def test_one_scan_of_other_angles_among_many_is_no_reason(tmp_path):
    assert choice_of(tmp_path, [*scans(), scan("/scan", 1.0, FOUR, angle_max=2.0)]).scans == ("/scan",)


def test_intensities_without_ranges_are_named(tmp_path):
    said = refused(tmp_path, [scan("/scan", step / 10, [], intensities=FOUR) for step in range(4)])
    assert "the scans of /scan: expected ranges, got none, and 4 intensities" in said


@pytest.mark.parametrize("frames", [("a", "b"), ("", "")])
def test_where_it_cannot_be_told_the_usual_name_is_taken_and_said(tmp_path, frames):
    said = [scan(name, 0.0, FOUR, frame=frame) for name, frame in zip(("/scan", "/stable_scan"), frames, strict=True)]
    chosen = choice_of(tmp_path, said)
    assert chosen.scans == ("/scan",)
    assert any("/stable_scan left out, /scan taken" in remark for remark in chosen.remarks)
