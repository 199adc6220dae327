# SPDX-License-Identifier: Apache-2.0
"""Impact speed limits of an arm: bounds of the robot, simulated loads of hits, and the largest safe speed."""
