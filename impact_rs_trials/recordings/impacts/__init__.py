# SPDX-License-Identifier: Apache-2.0
"""Impacts in recordings, and tables with one row per impact."""
