# SPDX-License-Identifier: Apache-2.0
"""Trials by messages, tick by tick, over any transport: side of the plant and side of the controller."""
