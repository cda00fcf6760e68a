"""What `solutions` returns: the solutions from one start, the choices that lead to each, and their exponents."""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..statuses import STATUS
from .spectrum import Spectrum

__all__ = ["Choice", "Solution", "Solutions"]


@dataclasses.dataclass(frozen=True)
class Choice:
    """What was chosen where a solution could go on in several ways.

    Attributes:
        t: when.
        kind: "order", of events that meet, or "mode", on a surface that repels and at a two-fold.
        options: what there was: "event 1 first" …, in the order of the guards; or names of modes.
        taken: one of them.
    """

    t: float
    kind: str
    options: tuple[str, ...]
    taken: str

    def __str__(self) -> str:
        return f"t = {self.t:.6g}: {self.taken} (of {', '.join(self.options)})"


class Solution(eqx.Module):
    """One solution.

    Attributes:
        choices: those that lead to it, in time.
        spectrum: its `lh.Spectrum`; its status is deadlock where it cannot be continued.
        exponents: (k,) descending, those of the spectrum; +inf where the solution ends sliding along a surface that
            repels: what is beside the surface leaves it at once.
    """

    choices: tuple[Choice, ...] = eqx.field(static=True)
    spectrum: Spectrum
    exponents: Float[np.ndarray, " k"]


class Solutions(eqx.Module):
    """The solutions from one start, as far as they were followed.

    Attributes:
        solutions: one `Solution` each.
        complete: whether these are all. Not where there are more than `most`, or where time goes by until a choice:
            a surface that repels may be left at any time; and at a two-fold, where sliding may go on.
        mode_names: of the system.

    Example:
        Two fields that point away from y = 0, where x grows with 1, or with −0.5:

        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> def field(rate, away):
        ...     return lambda t, x, args: jnp.stack([rate * x[0], away + 0 * x[1]])
        >>> apart = lh.filippov(field(1.0, 1.0), field(-0.5, -1.0), lambda t, x, args: x[1])
        >>> found = lh.solutions(apart, [0.0, 0.0], t1=10.0)
        >>> found.exponents[:, 0].round(6).tolist()
        [1.0, 0.0, inf]
        >>> found.complete  # it may slide for a while, and leave then
        False
    """

    solutions: tuple[Solution, ...]
    complete: bool = eqx.field(static=True)
    mode_names: tuple[str, ...] = eqx.field(static=True)

    @property
    def exponents(self) -> Float[np.ndarray, "solutions k"]:
        """One row a solution, descending; nan where it ended at once."""
        return np.stack([one.exponents for one in self.solutions])

    @property
    def lower(self) -> Float[np.ndarray, " k"]:
        """(k,) the smallest exponents of solutions that reached the end of the run; nan where none did."""
        return self._extreme(np.min)

    @property
    def upper(self) -> Float[np.ndarray, " k"]:
        """(k,) the largest."""
        return self._extreme(np.max)

    def _extreme(self, of):
        gone_on = [one.spectrum.status is STATUS.ok for one in self.solutions]
        rows = self.exponents
        return of(rows[gone_on], axis=0) if any(gone_on) else np.full(rows.shape[1], np.nan)

    def __len__(self) -> int:
        return len(self.solutions)

    def __repr__(self) -> str:
        more = "all there are" if self.complete else "there are more"
        lines = [f"{len(self)} solutions from one start ({more})"]
        for one in self.solutions:
            status = one.spectrum.status
            name = status.name if isinstance(status, STATUS) else str(status)
            lines.append(f"  exponents {', '.join(f'{value:.6g}' for value in one.exponents)}  {name}")
            lines += [f"    {choice}" for choice in one.choices]
        pairs = zip(self.lower, self.upper, strict=True)
        lines.append("  between " + ", ".join(f"[{low:.6g}, {high:.6g}]" for low, high in pairs))
        return "\n".join(lines)
