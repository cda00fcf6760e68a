"""An explorer for notebooks: sliders over parameters and start, and what the system then does."""

from .exploring import Explorer, explore

__all__ = ["Explorer", "explore"]
