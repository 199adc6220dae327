# SPDX-License-Identifier: Apache-2.0
"""Learning from every impact: the model's parameters are followed from hit to hit, and changes are announced."""
