"""What to measure next: poses, payloads and approaches that add most to what matters; matplotlib only for a picture."""
