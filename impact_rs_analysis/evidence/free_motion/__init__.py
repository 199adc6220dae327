# SPDX-License-Identifier: Apache-2.0
"""Torque balance of an arm in free motion, of one recording or of the difference of two."""
