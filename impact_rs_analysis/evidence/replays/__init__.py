# SPDX-License-Identifier: Apache-2.0
"""Replays of runs by the twin: windows, start states and features."""
