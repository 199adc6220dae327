"""The rclpy nodes, one per file, and the runner that ties them."""
