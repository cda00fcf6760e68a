"""The programs that are compared, each by itself optional: one module a program.

A module has ``KINDS``, from the kind of a workload to a function of the workload that returns a `Bound`.
"""

import math
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import numpy as np

from benchmarks.peers.workloads import Workload


class Bound(NamedTuple):
    """A workload made ready for one program."""

    ladder: dict[
        str, Any
    ]  # settings by name, several methods from coarse to fine each; the name begins with the method
    run: Callable[[Any, float], Any]  # (setting, length) -> exponents
    frame: np.ndarray | None = None  # the columns (n, k) that it begins with; None: the identity
    typical: int = 0  # which setting the first call has
    system: Any = None  # what a sweep takes from a single run


class Peer(NamedTuple):
    """A program, by the name of its distribution."""

    distribution: str
    module: str
    kinds: tuple[str, ...]
    use: str  # how it is used
    by_length: bool = False  # it compiles for each length, so that the first run of one says nothing
    repeated: float = 0.0  # seconds for which a run is repeated untimed: it optimises what is repeated
    largest: float = math.inf  # equations n (k + 1), beyond which it is not tried
    dense: bool = True  # whether it is tried where each component depends on all

    def can(self, workload: Workload) -> bool:
        """Whether it is asked."""
        small = workload.n * (workload.frame.shape[1] + 1) <= self.largest
        sparse = workload.forms is None or not workload.forms.dense
        return workload.kind in self.kinds and small and (self.dense or sparse)

    def adapter(self):
        """Its module, which imports the program."""
        return import_module(f"benchmarks.peers.adapters.{self.module}")

    @property
    def version(self) -> str | None:
        """None where it is not installed."""
        try:
            return version(self.distribution)
        except PackageNotFoundError:
            return None


OURS = "lyaphybrid"
SINGLE, SWEEPS = ("flow", "map", "stiff", "impact", "friction", "disks"), ("flow_sweep", "impact_sweep")
EVENTS = ("impact", "friction")
PEERS = {
    OURS: Peer("lyaphybrid", "ours", (*SINGLE, *SWEEPS), "`lyapunov_spectrum`, `sweep`", by_length=True, repeated=5.0),
    "lyapax": Peer(
        *("lyapax", "with_lyapax", ("flow", "map", "flow_sweep")),
        "`ode_problem` (rk4, rk6, adaptive) and `sweep_lyapunov_spectrum`, under `jax.jit`",
        by_length=True,
    ),
    "jitcode": Peer(
        *("jitcode", "with_jitcode", ("flow",), "`jitcode_lyap`, compiled C, dopri5, dop853"),
        largest=2000,
        dense=False,
    ),
    "heyoka": Peer(
        *("heyoka", "with_heyoka", ("flow", "stiff", *EVENTS, *SWEEPS)),
        "`var_ode_sys`, `taylor_adaptive`, terminal events, `taylor_adaptive_batch` for the flow's sweep; QR by NumPy; "
        "the variational equation of Kuramoto's model by hand",
    ),
    "pynamicalsys": Peer(
        "pynamicalsys", "with_pynamicalsys", ("flow", "map"), "`lyapunov`, QR, rk4 and rk45", largest=2000
    ),
    "chaotax": Peer(
        "chaotax", "with_chaotax", ("flow", "map"), "`lyapunov_spectrum` of an RK4 step, `jax.jit`", by_length=True
    ),
    "numba": Peer(
        *("numba", "with_numba", (*SINGLE, *SWEEPS)),
        "loops written by hand: RK4, Dormand–Prince, events by the secant method, disks, `prange` for sweeps",
    ),
    "scipy": Peer("scipy", "with_scipy", SINGLE, "`solve_ivp`, its `events`, NumPy's QR; disks by NumPy"),
    "diffrax": Peer("diffrax", "with_diffrax", ("impact",), "`diffeqsolve(event=…)` in a scan"),
}
