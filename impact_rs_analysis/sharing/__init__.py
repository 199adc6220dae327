# SPDX-License-Identifier: Apache-2.0
"""Evidence exchanged between laboratories: packages, their verification, and their meta-analysis."""
