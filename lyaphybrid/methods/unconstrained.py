"""What movers without modes have in common: no constraints, and nothing between two points."""

from typing import ClassVar

__all__ = ["Unconstrained"]


class Unconstrained:
    """Answers of a mover that knows no modes and no constraints."""

    compares_columns: ClassVar[bool] = False

    def does_little(self, n: int) -> bool:
        """Arrays are as good as numbers here."""
        del n
        return False

    def onto_mode(self, mode, t, x):
        """There are no modes, and no constraints."""
        del mode, t, x

    def admitted(self, t, x, mode):
        """Every state may be a start."""
        del t, mode
        return x, False

    def kept_to_constraints(self, c, clock):
        """There are none."""
        del clock
        return c

    def inspected(self, c, clock):
        """There is nothing that could be left."""
        del clock
        return c

    def in_each_mode(self):
        """There are no modes."""
        return (self,)

    def no_stages(self, x, frame):
        """There is nothing between two points."""
        del x, frame
        return ()
