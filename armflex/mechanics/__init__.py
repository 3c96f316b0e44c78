"""What a loaded arm does: where it comes to rest, and how its tip responds to whatever may be otherwise.

Two engines answer. `pinocchio_model` with `equilibrium` is the reference: one configuration at a time, with motion, and
any method. `kernel` and `tree_kernel` are compiled: many configurations, control loops, and the sensitivities that fits
need; `respond` asks them, and leaves to the reference what it cannot prove. All here know an arm as a `Structure`.
"""
