# SPDX-License-Identifier: Apache-2.0
"""Design of experiments: the trials that distinguish explanations best.

possible trials -> predictions under every explanation -> expected discrimination -> greedy choice -> plan
"""
