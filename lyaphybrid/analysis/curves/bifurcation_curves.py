"""Curves of bifurcations in the plane of two parameters: the result of `bifurcation_curve`."""

import dataclasses
from typing import Any

import numpy as np

from ... import plots
from ..._text import Table
from ...results.result import Data, in_time
from ...systems.labels import Labels
from ..continuation.branches import OrbitsAlong, SpecialOrbit
from ..orbits.periodic_orbits import Floquet

__all__ = ["BifurcationCurve", "CurveSpecial"]


@dataclasses.dataclass(frozen=True, repr=False)
class CurveSpecial(SpecialOrbit):
    """A point of a bifurcation curve at which one more condition holds.

    Attributes:
        kind: "cusp", "fold–flip", "1:1 resonance", "1:2 resonance", "1:3 resonance", "1:4 resonance", "grazing"
            or "Hopf".
        values: (2,) both parameters.
        orbit: an `lh.Floquet`.

    Example:
        >>> import lyaphybrid as lh
        >>> cubic = lh.Map(lambda n, x, args: args["a"] + (1 + args["b"]) * x - x**3)
        >>> args = {"a": 0.0, "b": 0.75}
        >>> branch = lh.continuation(cubic, [0.9], args, over={"a": (-1.0, 1.0)}, period=1)
        >>> over = {"a": (-1.0, 1.0), "b": (-0.5, 1.0)}
        >>> curve = lh.bifurcation_curve(cubic, branch.of_kind("fold")[0], args, over=over, period=1)
        >>> cusp = curve.specials[0]
        >>> cusp.kind, [round(abs(value), 9) for value in cusp.values.tolist()]
        ('cusp', [0.0, 0.0])
    """

    kind: str
    names: tuple[str, str]
    values: np.ndarray
    orbit: Floquet

    @property
    def title(self) -> str:
        """Kind and parameters in one line."""
        pairs = zip(self.names, self.values, strict=True)
        return f"{self.kind} at " + ", ".join(f"{name} = {value + 0.0:.9g}" for name, value in pairs)

    def _data(self) -> Data:
        orbit = self.orbit._data()
        variables = dict(orbit.variables) | {"values": ("parameter", self.values)}
        coordinates = dict(orbit.coordinates) | {"parameter": list(self.names)}
        return Data(variables, coordinates, dict(orbit.attributes) | {"kind": self.kind})


@dataclasses.dataclass(frozen=True, repr=False)
class BifurcationCurve(OrbitsAlong):
    """A curve of bifurcations, of grazing or of border collisions, in the plane of two parameters.

    Attributes:
        kind: what happens on the curve: "fold", "pitchfork", "transcritical", "period doubling", "Neimark–Sacker",
            "grazing", "edge" (an event falls on the zero of another guard, as where sliding begins at a crossing) or
            "border".
        parameters: the names of both parameters, the first one that of the branch.
        values: (points, 2) along the curve, which may turn back in both.
        orbits: an `lh.Floquet` for each point.
        specials: tuple of `CurveSpecial`, in the order of the curve: cusps; fold–flips (multipliers 1 and −1); 1:1,
            1:2, 1:3 and 1:4 resonances; "grazing", where the sequence of the events changes; "Hopf", where the orbit
            has shrunk to an equilibrium (on a curve of folds a generalised Hopf point, Bautin's).
        ends: why the curve ends at its first and at its last point: "range" (of `over`), "closed", "max_points", "no
            convergence" (of Newton's method, whatever the step), "interrupted" (by Ctrl-C), or the kind of the special
            at which it ends.
        angles: (points,) θ of the multipliers exp(±iθ) on a Neimark–Sacker curve, else NaN.

    Example:
        >>> import jax.numpy as jnp, numpy as np, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, p: jnp.stack([1 - p["a"] * x[0] ** 2 + x[1], p["b"] * x[0]]))
        >>> args = {"a": 0.3, "b": 0.3}
        >>> branch = lh.continuation(henon, [0.6, 0.2], args, over={"a": (0.2, 0.5)}, period=1)
        >>> over = {"a": (0.1, 3.5), "b": (-1.2, 0.6)}
        >>> curve = lh.bifurcation_curve(henon, branch.specials[0], args, over=over, period=1)
        >>> a, b = curve.values.T
        >>> bool(np.allclose(a, 3 * (1 - b) ** 2 / 4))
        True
        >>> list(curve.specials)
        [1:2 resonance at a = 3, b = -1]
    """

    kind: str
    parameters: tuple[str, str]
    values: np.ndarray
    orbits: tuple[Floquet, ...]
    specials: tuple[CurveSpecial, ...]
    ends: tuple[str, str]
    angles: np.ndarray
    state_labels: Labels = Labels()

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The curve in the plane of its parameters. `style` goes to the line."""
        return plots.curves(self, ax, **style)

    def _table(self) -> Table:
        ranges = ", ".join(
            f"{name} from {np.min(column):.6g} to {np.max(column):.6g}"
            for name, column in zip(self.parameters, self.values.T, strict=True)
        )
        title = f"Curve of {self.kind}: {ranges}, {len(self.values)} points; ends: {self.ends[0]}, {self.ends[1]}"
        return Table(title, notes=[special.title for special in self.specials])

    def _data(self) -> Data:
        special_values = np.array([special.values for special in self.specials]).reshape(-1, 2)
        variables = {
            "x0": (("point", "state"), self.x0),
            "multipliers": (("point", "exponent"), self.multipliers),
            "period": ("point", self.period, in_time(self.state_labels.time_unit)),
            "angles": ("point", self.angles),
            "special_kind": ("special", [special.kind for special in self.specials]),
            "special_values": (("special", "parameter"), special_values),
            "values": (("point", "parameter"), self.values),
        }
        coordinates = {
            "state": self.state_labels.columns(self.x0.shape[1]),
            "exponent": np.arange(1, self.multipliers.shape[1] + 1),
            "parameter": list(self.parameters),
        }
        return Data(variables, coordinates, {"kind": self.kind, "ends": self.ends})
