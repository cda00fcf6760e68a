"""Linear algebra: frames and their orthonormalisation, small and banded systems, products of matrices."""
