"""Random cases whose right answer is known: see `__main__.py`."""
