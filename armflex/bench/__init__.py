"""Joint deformation models from measured loads and deflections."""
