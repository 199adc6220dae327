# SPDX-License-Identifier: Apache-2.0
"""Bags: one trial is one rosbag2 folder with mcap storage."""
