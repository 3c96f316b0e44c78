"""What tests, studies and benchmarks share: small arms, an unrelated plant, campaigns, and how each is asked."""
