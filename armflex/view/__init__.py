"""What people look at: headless meshcat pages of an arm."""
