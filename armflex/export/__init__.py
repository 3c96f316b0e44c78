"""The arm as other programs read it: each format is a module with a function `export(arm, **options) -> Exported`.

A format refuses by name what it cannot carry, or says in `Exported.told` what that amounts to.
"""
