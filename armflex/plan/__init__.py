"""What to measure next: poses, payloads and approaches that add most to what matters; matplotlib only for a picture."""

MOST_ASKED = 100
"""Tolerance: rows that can be asked for at once to decide between causes."""
