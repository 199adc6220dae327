# SPDX-License-Identifier: Apache-2.0
"""From unknown files to a mapping: hypotheses about every stream, and the likelihood of each."""
