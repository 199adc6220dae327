# SPDX-License-Identifier: Apache-2.0
"""The physics, free of ROS: robot model, effects, plant, impact map and scenario."""
