"""Tracing as a posterior over sets of effects: one evidence decides what is added, exchanged and withdrawn."""
