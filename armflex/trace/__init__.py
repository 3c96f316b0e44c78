"""From a calibrated arm's residual to the effect that it lacks."""
