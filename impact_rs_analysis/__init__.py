# SPDX-License-Identifier: Apache-2.0
"""The offline side, free of ROS: bags, net feedback, comparison, diagnosis and report."""
