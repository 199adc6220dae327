"""The net-feedback measure: integrals, fits, tables, the whole study."""
