# SPDX-License-Identifier: Apache-2.0
"""Sequential estimation from hit to hit: posterior of the model parameters, and change-point detection."""
