# SPDX-License-Identifier: Apache-2.0
"""The net-feedback measure: integrals, fits, tables and the study."""
