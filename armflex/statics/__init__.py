"""One configuration: the loads at every flexure, the equilibrium, what the tip does, and how it answers to changes."""
