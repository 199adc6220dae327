# SPDX-License-Identifier: Apache-2.0
"""Evidence: measurements against a model, as scaled residuals and their sensitivities."""
