"""Tables in: campaigns of tip readings and joints on a bench, units converted once, nothing dropped silently."""
