# SPDX-License-Identifier: Apache-2.0
"""Scenario files: scene, motion of the robots and measurement, and the files that they name."""
