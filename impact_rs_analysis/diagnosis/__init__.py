"""Which physical effect is missing: screening, fitting through the source, and honest verdicts."""
