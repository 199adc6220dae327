# SPDX-License-Identifier: Apache-2.0
"""What the commands of ``impact-rs`` do, one per file; :mod:`impact_rs_commands` declares them."""
