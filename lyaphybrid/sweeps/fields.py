"""`ftle_field`: finite-time exponents over a grid of starts."""

from typing import Any

import equinox as eqx
import numpy as np

from .. import plots
from .._arguments import Progress, Real, positive, require, require_values
from .._keywords import explains_keywords
from .._text import Table, per_unit, with_unit
from ..analysis.trajectories import tangent_map
from ..engine.blocks import check_counts
from ..engine.preparation import grown_columns
from ..integrators.base import Method
from ..results.result import Data, RunResult, exponents_along, per_time, states_along
from ..statuses import OK
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.labels import Labels
from ..systems.smooth import Flow, Map
from .ridges import ridge_points
from .starts import starts_of, status_lines

__all__ = ["FTLEField", "ftle_field"]

ROUNDED_AWAY = 1e-14  # singular values below this part of the largest are rounding


class FTLEField(RunResult, eqx.Module):
    """Finite-time exponents ln σ_i / t1 of dx(t0 + t1)/dx(t0), over a grid of starts.

    Attributes:
        exponents: (…, n) descending, in the shape of the grid; nan where a run failed, and where the singular value is
            too small beside the largest to be told from rounding.
        stretched: (…, n) the unit vector at the start that grows most.
        axes: the varied components, by index, and their values.
        jumps: (…) of each run.
        status_code: (…) how each run ended; status: the gravest.
        t1: the length of the runs.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> saddle = lh.Flow(lambda t, x, a: jnp.stack([x[0], -x[1]]), names=("x", "y"))
        >>> field = lh.ftle_field(saddle, [[-1.0, -1.0], [1.0, 1.0]], t1=2.0, shape=(4, 3))
        >>> field.exponents.shape, field.exponents[0, 0].round(6).tolist()
        ((4, 3, 2), [1.0, -1.0])
    """

    exponents: np.ndarray
    stretched: np.ndarray
    axes: dict[int, np.ndarray]
    jumps: np.ndarray
    status_code: np.ndarray
    t1: float
    state_labels: Labels = eqx.field(static=True)

    def ridges(self, width: float = 1.0, sharpest: float = 0.1) -> np.ndarray:
        """Points (m, 2) on ridges of the largest exponent: where motions part most; of grids of two components.

        Over a long time such ridges are close to stable manifolds (Lagrangian coherent structures). S. C. Shadden, F.
        Lekien & J. E. Marsden, Physica D 212 (2005) 271, doi:10.1016/j.physd.2005.10.007.

        Args:
            width: standard deviation, in cells, of the Gaussian that smooths the exponents.
            sharpest: the part of the points on ridges that is returned, the sharpest.

        Raises:
            ValueError: for another number of components; on arguments that do not fit.

        Example:
            >>> import jax.numpy as jnp, lyaphybrid as lh
            >>> pendulum = lh.Flow(lambda t, x, a: jnp.stack([x[1], -jnp.sin(x[0])]))
            >>> field = lh.ftle_field(pendulum, [[-3.0, 0.5], [0.0, 2.5]], t1=12.0, shape=(60, 40))
            >>> x, v = field.ridges().T  # the separatrix, v² = 2 + 2 cos x
            >>> bool(abs(v**2 / 2 - jnp.cos(x) - 1).max() < 0.1)
            True
        """
        require(len(self.axes) == 2, f"Ridges need a grid of two components; this one has {len(self.axes)}.")
        positive("width", width)
        require(0 < sharpest <= 1, f"sharpest must be above 0 and at most 1; got {sharpest!r}.")
        places, _ = ridge_points(self.exponents[..., 0], float(width), float(sharpest))
        axes = self.axes.values()
        return np.stack(
            [np.interp(place, np.arange(len(axis)), axis) for place, axis in zip(places.T, axes, strict=True)], axis=1
        )

    def plot(self, ax: plots.Axes | None = None, *, exponent: int = 1, **style: Any) -> plots.Axes:
        """An exponent over a grid of two components, the largest by default. `style` goes to what it draws."""
        require(len(self.axes) == 2, f"A picture needs a grid of two components; this one has {len(self.axes)}.")
        return plots.ftle_field(self, ax, exponent=exponent, **style)

    def _table(self) -> Table:
        rows = []
        for i in range(self.exponents.shape[-1]):
            values = self.exponents[..., i]
            known = values[np.isfinite(values)]
            found = (f"{one:.6g}" for one in (np.min(known), np.median(known), np.max(known))) if len(known) else "———"
            rows.append((f"λ{i + 1}", *found))
        unit = self.state_labels.time_unit
        t1 = with_unit(f"{self.t1:g}", unit)
        title = f"Finite-time exponents{per_unit(unit)} of {self.status_code.size} starts (t1 = {t1})"
        return Table(title, rows, status_lines(self), ("", "least", "median", "greatest"))

    def _data(self) -> Data:
        along = tuple(self.state_labels.name(i) for i in self.axes)
        n = self.exponents.shape[-1]
        variables = {
            "exponents": ((*along, "exponent"), self.exponents, per_time(self.state_labels.time_unit)),
            "stretched": ((*along, "state"), self.stretched),
            "jumps": (along, self.jumps),
            "status_code": (along, self.status_code),
        }
        axes = {self.state_labels.name(i): values for i, values in self.axes.items()}
        return Data(variables, {**exponents_along(n), **states_along(self.state_labels, n), **axes}, {"t1": self.t1})


@explains_keywords
def ftle_field(
    system: Flow | Map | Hybrid | EventDriven,
    x0: Any,
    args: Any = None,
    *,
    t1: Real,
    shape: Any,
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    max_steps: int | None = None,
    chunk: int | None = None,
    store: Any = None,
    client: Any = None,
    progress: Progress = None,
) -> FTLEField:
    """Finite-time Lyapunov exponents over a grid of starts, through jumps.

    They are ln σ_i / t1 of the singular values of `tangent_map`, one run for each start, on all cores. The directions
    that grow belong to these starts and this time. Over a long time the ridges of the largest exponent are close to
    stable manifolds; of a reversed field, to unstable ones.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (2, n) corners of the box of starts; components that are equal in both corners are not varied.
        args: pytree of parameters.
        t1: length in time (iterations for a map). Beyond ln(σ₁/σ_n) = 32 the smallest singular value is rounding.
        shape: numbers of cells along the varied components: starts are the cells' middles.
        t0: time at the start.
        mode: mode at the start, where there are several and the system does not determine it.
        method: as for `lh.lyapunov_spectrum`, except `lh.ContinuousQR`.
        max_steps: most attempts of a step in one run.
        chunk: as for `lh.sweep`.
        store: path of a zarr store, where each chunk is kept as soon as it is computed; the same call goes on with it.
        client: a `dask.distributed.Client`, as for `lh.sweep`.
        progress: True for a bar, or a function of the fraction done.

    Returns:
        An `FTLEField` with `.exponents`, `.stretched`, `.status_code`, `.ridges()`, `.plot()`.

    Raises:
        ValueError: on arguments that do not fit, before any computing.
        StoreFailedError: if the store cannot be written.
        ImportError: without the extra "sweep".

    Source:
        G. Haller, Distinguished material surfaces and coherent structures in three-dimensional fluid flows, Physica D
        149 (2001) 248, doi:10.1016/S0167-2789(00)00199-8.

    Example:
        A shear: σ₁ of [[1, t], [0, 1]] is (t + √(t² + 4))/2.

        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> shear = lh.Flow(lambda t, x, a: jnp.stack([x[1], 0 * x[1]]))
        >>> found = lh.ftle_field(shear, [[0.0, 0.0], [1.0, 1.0]], t1=1.5, shape=(2, 2))
        >>> round(float(found.exponents[0, 0, 0]), 12) == round(float(jnp.log(2.0) / 1.5), 12)
        True
    """
    require_values("ftle_field", t1)
    positive("t1, a length of time,", t1)
    grown_columns("ftle_field", method)
    check_counts(system, t1=t1)
    starts = starts_of("ftle_field", system, x0, args, shape, t0=t0, method=method, mode=mode, max_steps=max_steps)

    def run(args, x0):
        found = tangent_map(system, x0, args, t1=t1, t0=t0, mode=mode, method=method, max_steps=max_steps, throw=False)
        return {"matrix": found.matrix, "jumps": found.jumps, "status_code": found.status_code}

    found = starts.swept(run, args, chunk=chunk, store=store, client=client, progress=progress)
    status = found["status_code"]
    exponents, stretched = _singular(found["matrix"], status, float(t1))
    return FTLEField(
        exponents.reshape(*starts.cells, -1),
        stretched.reshape(*starts.cells, -1),
        starts.axes,
        found["jumps"].reshape(starts.cells),
        status.reshape(starts.cells),
        float(t1),
        starts.labels,
    )


def _singular(matrices: np.ndarray, status: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """The exponents ln σ / length, and the directions that grow most; nan where a run did not end well."""
    good = (status == OK) & np.all(np.isfinite(matrices), axis=(1, 2))
    _, sizes, directions = np.linalg.svd(np.where(good[:, None, None], matrices, np.eye(matrices.shape[1])))
    resolved = good[:, None] & (sizes > ROUNDED_AWAY * sizes[:, :1])
    exponents = np.where(resolved, np.log(np.where(resolved, sizes, 1.0)) / length, np.nan)
    return exponents, np.where(good[:, None], directions[:, 0], np.nan)
