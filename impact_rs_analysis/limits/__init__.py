# SPDX-License-Identifier: Apache-2.0
"""How fast an arm may hit: bounds of the robot, what hits do to it, and the speed up to which the bounds hold."""
