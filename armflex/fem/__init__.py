"""Meshes of structures, condensed to stiffness, mass and weight where they join their neighbours.

A room of its own beside the laws: it reads meshes, assembles them with the shape functions and quadratures of
scikit-fem, and condenses them onto interfaces. `part` alone is imported by an arm that names a condensed part, and
needs neither package.
"""
