"""An independent program of ROS 1, run by the system's Python, that sends what is odd: one kind, once a second.

Usage: ros1_odd_scans.py three|stamp|frame|angles|large|type|map|transform
"""

import math
import sys

import rospy
from geometry_msgs.msg import Quaternion, TransformStamped
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage


def odd(what):
    """The topic, and the message."""
    if what == "type":
        return "/scan", String("hello")
    if what in ("map", "transform"):
        link = TransformStamped()
        link.header.frame_id, link.child_frame_id = ("map", "odom") if what == "map" else ("odom", "base_link")
        link.transform.rotation = Quaternion(0, 0, 0, 1 if what == "map" else math.nan)
        return "/tf", TFMessage([link])
    scan = LaserScan(angle_min=-1.0, angle_increment=0.01, range_max=30.0, ranges=[1.0] * 100)
    scan.header.frame_id, scan.header.stamp = "laser", rospy.Time(5)
    if what == "three":
        scan.ranges = [1.0, 1.0, 1.0]
    elif what == "stamp":
        scan.header.stamp = rospy.Time(0)
    elif what == "frame":
        scan.header.frame_id = ""
    elif what == "angles":
        scan.angle_min = math.nan
    elif what == "large":
        scan.ranges = [1.0] * 26_214_400  # 100 MB
    return "/scan", scan


def main():
    rospy.init_node("odd", drop_correspondences=True)
    topic, message = odd(sys.argv[1])
    publisher = rospy.Publisher(topic, type(message), queue_size=1)
    while not rospy.is_shutdown():
        publisher.publish(message)
        rospy.rostime.wallsleep(1.0)


main()
