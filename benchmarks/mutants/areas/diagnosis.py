"""Residuals, sensitivities, search and verdicts."""

from mutant import Mutant

MUTANTS: list[Mutant] = []
