"""Where residuals and sensitivities come from: one module per source."""
