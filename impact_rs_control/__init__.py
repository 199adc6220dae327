# SPDX-License-Identifier: Apache-2.0
"""The controller side, free of ROS: references, QP, modes and impact detection."""
