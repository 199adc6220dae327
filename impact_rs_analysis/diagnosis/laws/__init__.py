# SPDX-License-Identifier: Apache-2.0
"""Laws outside the library: a grammar of formulas and the search in it."""
