"""Bags of ROS 1 and ROS 2, read by the package `rosbags` without ROS."""
