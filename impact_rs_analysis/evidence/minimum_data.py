# SPDX-License-Identifier: Apache-2.0
"""Minimum data of a verdict, which determines how measurements are grouped into clusters."""

MIN_DEGREES_OF_FREEDOM = 3  # of the pure error, runs minus conditions; with fewer it may be wrong by a factor of 10
MIN_CLUSTERS = 3  # for a hold-out: with two, each would be predicted from a single cluster
MIN_BLOCKS = 12  # without repeats: 2^11 patterns of signs resolve p = 0.0005
