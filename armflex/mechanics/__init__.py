"""What a loaded arm does: where it comes to rest, and how its tip responds to whatever may be otherwise.

`engine` is one text in C: many configurations, control loops, and the sensitivities that fits need. `pinocchio_model`
with `equilibrium` is the reference: one configuration at a time, with motion, and whatever the engine cannot prove. All
here know an arm as a `Structure`.
"""
