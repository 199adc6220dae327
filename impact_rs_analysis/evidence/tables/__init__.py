# SPDX-License-Identifier: Apache-2.0
"""Tables of impacts as evidence: groups of rows, and their predictions by the impact map."""
