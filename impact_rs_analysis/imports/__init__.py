"""Recordings of robots that nobody here made: reading them, and what a free motion says about the model."""
