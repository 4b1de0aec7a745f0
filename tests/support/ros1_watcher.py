"""An independent program of ROS 1, run by the system's Python, that tells as JSON what it sees of a node.

It listens to transforms until the file named first appears, and only then joins to see the map of the node named next.

Nothing of the package is imported: messages are those of ROS, transforms are looked up by tf2.
"""

import json
import os
import sys
import time

import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import MapMetaData, OccupancyGrid
from nav_msgs.srv import GetMap
from std_msgs.msg import Float64


def described(grid):
    cells = list(grid.data)
    return {
        "frame": grid.header.frame_id,
        "width": grid.info.width,
        "height": grid.info.height,
        "resolution": grid.info.resolution,
        "origin": [grid.info.origin.position.x, grid.info.origin.position.y, grid.info.origin.orientation.w],
        "cells": len(cells),
        "counts": {str(value): cells.count(value) for value in sorted(set(cells))},
        "sum": sum(k % 9973 * value for k, value in enumerate(cells)),
    }


def latched(topic):
    """What a latched topic has for a late joiner; None where it is not there, or not latched."""
    try:
        return rospy.wait_for_message(topic, Float64, timeout=2).data
    except rospy.ROSException:
        return None


def settle(told, seconds=120.0):
    """Wait until the node has said twice that it has done all that it has received, and then for its next map."""
    end, before = time.monotonic() + seconds, {}
    while time.monotonic() < end:
        values = told.get("values", {})
        if values and values is not before:
            ends = ("accepted", "refused", "dropped", "throttled", "paused")
            done = sum(int(values[name]) for name in ends) == int(values["received"])
            if done and before.get("received") == values["received"]:
                break
            before = values
        time.sleep(0.1)
    time.sleep(1.0)


def main():
    rospy.init_node("watcher", drop_correspondences=True, disable_signals=True)
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    told = {}

    def diagnostics(message):
        status = message.status[0]
        told["level"], told["values"] = status.level, {pair.key: pair.value for pair in status.values}

    print("listening", flush=True)
    while not os.path.exists(sys.argv[1]):
        time.sleep(0.05)
    rospy.Subscriber("/diagnostics", DiagnosticArray, diagnostics)
    settle(told)
    for _ in range(20):  # the last map comes at its interval
        found = {
            "map": described(rospy.wait_for_message("/map", OccupancyGrid, timeout=60)),
            "metadata_width": rospy.wait_for_message("/map_metadata", MapMetaData, timeout=60).width,
            "dynamic_map": described(rospy.ServiceProxy("/dynamic_map", GetMap)().map),
            "entropy": latched(rospy.names.ns_join(sys.argv[2], "entropy")),
        }
        if found["map"] == found["dynamic_map"] and found["metadata_width"] == found["map"]["width"]:
            break
    for name in sys.argv[3:]:
        parent, child = name.split(":")
        try:
            link = buffer.lookup_transform(parent, child, rospy.Time(0), rospy.Duration(0)).transform
            found[name] = [link.translation.x, link.translation.y, link.rotation.z, link.rotation.w]
        except tf2_ros.TransformException as error:
            found[name] = str(error)
    print(json.dumps({**found, "diagnostics": told}))
    listener.unregister()


main()
