"""Recordings that were not made here, and the mapping files that say where their signals are."""
