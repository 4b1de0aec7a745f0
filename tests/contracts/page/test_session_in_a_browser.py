"""Which session goes on, and where the robot was found again, in a real browser."""

import numpy as np

from gridslam.cli.live import node_page
from gridslam.live.options import LiveOptions
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.browsing import shown, text, wait
from support.node_faults import QUICK, SHIFT_NS, RunningNode, is_prepared
from support.ros_node import LocalTransport, mounting, play, until


def test_the_session_is_named_and_where_the_robot_was_found_is_marked(browser, screenshot, tmp_path, capsys):
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=180), rng)
    drive = list(log.measurements)[:300]
    first = RunningNode(save=str(tmp_path / "floor.gridslam"))
    first.play(drive)
    first.stop()
    transport = LocalTransport()
    given = {**QUICK, "continue": str(tmp_path / "floor.gridslam")}
    core = RosNode(transport, node_parameters(given, "default")).core
    core.on_transforms([mounting()], static=True)
    with node_page(LiveOptions(port=0), "robot", core, None):
        browser.get(capsys.readouterr().err.split("live at ")[1].split()[0])
        core.start()
        shift_ns = SHIFT_NS + 3600 * 10**9
        play(core, transport.outputs, drive[:5], shift_ns=shift_ns)
        assert until(lambda: is_prepared(core), 60.0)
        play(core, transport.outputs, drive[5:30], shift_ns=shift_ns)
        wait(lambda: "looking for the robot in its map" in text(browser, "#goes-on"), "the search")
        wait(lambda: "floor.gridslam 1 drive" in text(browser, "#goes-on"), "the session's name")
        play(core, transport.outputs, drive[30:], shift_ns=shift_ns)
        wait(lambda: "found again after" in text(browser, "#goes-on"), "found again")
        assert shown(browser, "goes-on")
        way = f"found again after {core._session.found_after_m:.1f} m, at "
        assert way in text(browser, "#goes-on")
        screenshot("found")
        core.close()
