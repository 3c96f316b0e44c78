"""Files that armflex writes and reads again: arrays of a declared layout, and folders of finished work."""
