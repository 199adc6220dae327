# SPDX-License-Identifier: Apache-2.0
"""Evidence that laboratories exchange: packages, their check, and what they say together."""
