"""Sources that flows of several families are from."""

BOOK = "J. C. Sprott, Chaos and Time-Series Analysis, Oxford (2003)"
