"""Attacks that count: mutants of bags, of YAML and of command lines. Results: ``docs/reliability.md``."""
