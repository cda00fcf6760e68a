"""Indicators of chaos: computed from the orthonormalisations of deviation vectors in the one loop."""
