"""Seams: places along the first axis of a lazy array where one of its pieces ends and the next begins.

A neighbour in a ring is `jnp.roll`, two slices that are concatenated. Written to memory, each neighbour of a frame
would be one more array to write and to read. Instead the concatenation stays lazy, and a loop over an array that reads
it is cut at its seams: within each part all indices are known to lie in one piece.
"""

from collections.abc import Iterable
from typing import Any

MOST_SEAMS = 6  # of one loop: each adds a copy of its body

Seams = tuple[int, ...]


def united(several: Iterable[Iterable[int]]) -> Seams:
    """The seams of a loop that reads all these arrays."""
    return tuple(sorted({seam for seams in several for seam in seams}))


def within(seams: Seams, first: int, length: int) -> Seams:
    """The seams of the part that begins at `first`."""
    return tuple(seam - first for seam in seams if first < seam < first + length)


def cut(length: int, seams: Seams) -> list[tuple[int, int]]:
    """The parts (first, end) of a loop."""
    places = [0, *seams, length]
    return list(zip(places[:-1], places[1:], strict=True))


class Spans:
    """Between which numbers the indices of loops lie, and their sums with constants."""

    def __init__(self):
        self._known: dict[Any, tuple[int, int]] = {}  # index: [first, end)

    def note(self, index: Any, first: int, end: int) -> None:
        """An index lies in [first, end)."""
        self._known[index] = first, end

    def shift(self, total: Any, a: Any, b: Any) -> None:
        """An index is the sum of two, of which one may be a constant."""
        index, by = (a, b) if isinstance(a, str) else (b, a)
        if not isinstance(by, str) and index in self._known:
            first, end = self._known[index]
            self.note(total, first + by, end + by)

    def inside(self, index: Any, first: int, end: int) -> bool:
        """Whether an index is known to lie in [first, end)."""
        least, beyond = self._known.get(index, (first - 1, end)) if isinstance(index, str) else (index, index + 1)
        return first <= least and beyond <= end
