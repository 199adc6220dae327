# SPDX-License-Identifier: Apache-2.0
"""Which physical effect is missing: screening, fitting through the simulation, hold-out and verdicts."""
