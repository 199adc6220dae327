# SPDX-License-Identifier: Apache-2.0
"""Robots: facts, checks, URDF, and rigid-body terms by Pinocchio."""
