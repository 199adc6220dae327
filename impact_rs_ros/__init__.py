# SPDX-License-Identifier: Apache-2.0
"""The rclpy nodes, one per file, and the runner that ties them. Importing them changes nothing in a process."""
