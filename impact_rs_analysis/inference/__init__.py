# SPDX-License-Identifier: Apache-2.0
"""The linear Gaussian model of residuals, for all that decides on it.

noise -> observation (whitened) -> belief (parameters and model discrepancy) -> log ratio of explanations -> forecast
"""
