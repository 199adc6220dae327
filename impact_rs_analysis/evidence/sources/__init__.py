# SPDX-License-Identifier: Apache-2.0
"""Sources of residuals and sensitivities, one module per kind of measurement."""
