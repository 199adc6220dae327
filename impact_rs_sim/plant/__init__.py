# SPDX-License-Identifier: Apache-2.0
"""The simulated plant: Bullet or the twin for mechanics, drives, pads and sensors."""
