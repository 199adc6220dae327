"""Bags: one trial is one rosbag2 folder with mcap storage."""
