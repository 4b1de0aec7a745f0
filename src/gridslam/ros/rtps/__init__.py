"""RTPS, the wire protocol of DDS: what the node needs of it to be part of a ROS 2 without any ROS or DDS library.

Source: OMG, The Real-time Publish-Subscribe Protocol (RTPS) DDS Interoperability Wire Protocol, version 2.5, document
formal/22-04-01.
"""
