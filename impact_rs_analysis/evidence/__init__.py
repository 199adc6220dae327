# SPDX-License-Identifier: Apache-2.0
"""Where residuals and sensitivities come from: one module per source."""
