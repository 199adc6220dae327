# SPDX-License-Identifier: Apache-2.0
"""Trials by messages, tick by tick, over any transport: the plant's side and the controller's."""
