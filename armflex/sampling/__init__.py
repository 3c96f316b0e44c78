"""Samplers of any density, and whether their chains can be trusted."""
