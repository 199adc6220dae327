"""The physics, free of ROS: robot model, effects, plant, impact map and scenario."""
