# SPDX-License-Identifier: Apache-2.0
"""Attacks that count: mutants of bags, of YAML and of command lines. Results: ``docs/reliability.md``."""
