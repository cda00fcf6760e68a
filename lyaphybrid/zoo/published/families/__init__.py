"""The published flows, by what they describe."""
