"""Which topics and frames of a bag are taken, and when the user must say it."""

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
    chosen = choice_of(tmp_path, both, scan_topics=("/r2/scan",), odometry_topic="/r2/odom")
    assert (chosen.odometry, chosen.base_frame) == ("/r2/odom", "r2/base_link")


MOUNTED = [transform(0.0, "base_link", "laser")]


SWINGING = [transform(0.0, "base_link", "laser"), transform(0.1, "base_link", "laser", (0.0, 0.0, 0.1), topic="/tf")]


@pytest.mark.parametrize(
    ("links", "why"),
    [
        (MOUNTED, "several topics of one laser (in one frame)"),
        ([], "the mounting of /a_scan (laser) is unknown"),
        (SWINGING, "/a_scan moves on the robot"),
    ],
)
def test_of_topics_that_do_not_go_together_only_scan_is_taken_unasked(tmp_path, links, why):
    said = [*links, *(scan(name, 0.1 * k, FOUR) for name in ("/a_scan", "/b_scan") for k in range(3))]
    refusal = refused(tmp_path, said)
    assert why in refusal
    assert "choose with --scan TOPIC among /a_scan, /b_scan" in refusal
    (tmp_path / "log.bag").unlink()
    assert choice_of(tmp_path, said, scan_topics=("/b_scan",)).scans == ("/b_scan",)
    (tmp_path / "log.bag").unlink()
    chosen = choice_of(tmp_path, [*said, scan("/scan", 0.1, FOUR)])
    assert chosen.scans == ("/scan",)
    (remark,) = chosen.remarks
    assert remark.startswith("/a_scan, /b_scan left out, /scan taken: ")


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


def moving(topic, frames=("odom", "base_link")):
    return [odometry(topic, step / 20, (step / 20, 0, 0), frames=frames) for step in range(41)]


def test_of_several_odometries_the_one_named_odom_is_taken(tmp_path):
    said = [scan("/scan", 1.0, FOUR), *moving("/odometry/filtered"), *moving("/wheels/odom")]
    assert choice_of(tmp_path, said).odometry == "/wheels/odom"
    (tmp_path / "log.bag").unlink()
    assert "choose with --odom TOPIC among /a, /b" in refused(tmp_path, [said[0], *moving("/a"), *moving("/b")])


def test_ground_truth_alone_is_no_odometry_unless_it_is_named(tmp_path):
    said = [scan("/scan", 1.0, FOUR), *moving("/gt")]
    assert choice_of(tmp_path, said).odometry_frame == ""
    (tmp_path / "log.bag").unlink()
    assert choice_of(tmp_path, said, odometry_topic="gt").odometry == "/gt"


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


@pytest.mark.parametrize("wrong", [{"angle_max": 0.6}, {"angles": (-1.0, 0.0)}, {"ranges": [], "intensities": FOUR}])
def test_single_scans_that_no_map_can_be_made_of_are_left_out_and_named(tmp_path, wrong):
    fields = {"ranges": FOUR, **wrong}
    log = BagLog(
        ros_bags.write(tmp_path, "db3", [*scans(), *(scan("/scan", 0.4 + k / 10, **fields) for k in range(3))])
    )
    assert len(list(log)) == 4
    ((remark, count),) = log.statistics.remarks.items()
    assert count == 3
    assert remark.startswith("scans of /scan left out, of which no map can be made: expected ")
