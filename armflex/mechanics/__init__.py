"""What a loaded arm does: where it comes to rest, and how its tip responds to whatever may be otherwise.

Two engines answer. `pinocchio_model` with `equilibrium` is the reference: one configuration at a time, with motion, and
any method. `kernel` is compiled: many configurations, control loops, and the sensitivities that fits need; `respond`
asks it, and leaves to the reference what it cannot prove. Everything here knows an arm as a `Structure`.
"""
