# SPDX-License-Identifier: Apache-2.0
"""Search for effects: candidates, fits, selection, cross-validation and null distributions."""
