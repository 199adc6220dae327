"""Model against measurement: the same signals, the same features, and their differences."""
