"""Many configurations at once, in arrays: the same answers as one by one."""
