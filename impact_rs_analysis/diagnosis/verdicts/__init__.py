# SPDX-License-Identifier: Apache-2.0
"""Verdicts on the model and on effects, in numbers and in words."""
