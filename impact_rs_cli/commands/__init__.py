# SPDX-License-Identifier: Apache-2.0
"""Implementations of the commands of ``impact-rs``, one per file; :mod:`impact_rs_commands` declares them."""
