# SPDX-License-Identifier: Apache-2.0
"""Trials: what one is, where it is recorded, and campaigns of them; other people's recordings as well."""
