# SPDX-License-Identifier: Apache-2.0
"""Recordings from other sources, and the mapping files that locate their signals."""
