# SPDX-License-Identifier: Apache-2.0
"""Recordings that were not made here, and the mapping files that say where their signals are."""
