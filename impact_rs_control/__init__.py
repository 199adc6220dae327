"""The controller side, free of ROS: references, QP, modes and impact detection."""
