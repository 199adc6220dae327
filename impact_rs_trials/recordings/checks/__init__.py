# SPDX-License-Identifier: Apache-2.0
"""Checks of recorded signals: clocks, signs, units, outliers and sampling, without a model of friction."""
