"""Which physical effect is missing: screening, fitting through the twin, and honest verdicts."""
