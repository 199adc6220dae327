# SPDX-License-Identifier: Apache-2.0
"""The linear Gaussian model of residuals, on which verdicts, plans and change detection are based.

noise -> observation (whitened) -> belief (parameters and model discrepancy) -> log ratio of explanations -> forecast
"""
