"""The programs that are compared, each by itself optional: one module a program.

A module has ``KINDS``, from the kind of a workload to a function of the workload that returns a `Bound`.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import numpy as np


class Bound(NamedTuple):
    """A workload made ready for one program."""

    ladder: dict[
        str, Any
    ]  # settings by name, several methods from coarse to fine each; the name begins with the method
    run: Callable[[Any, float], Sequence[float]]  # (setting, length) -> exponents
    frame: np.ndarray | None = None  # the columns (n, k) that it begins with; None: the identity
    typical: int = 0  # which setting the first call has


class Peer(NamedTuple):
    """A program, by the name of its distribution."""

    distribution: str
    module: str
    kinds: tuple[str, ...]
    use: str  # how it is used
    compiles: bool = True  # so that the first run of a setting says nothing

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
PEERS = {
    OURS: Peer("lyaphybrid", "ours", ("flow", "map", "impact"), "`lyapunov_spectrum`"),
    "lyapax": Peer("lyapax", "with_lyapax", ("flow", "map"), "`ode_problem` (rk4, rk6, adaptive), under `jax.jit`"),
    "jitcode": Peer("jitcode", "with_jitcode", ("flow",), "`jitcode_lyap`, compiled C, dopri5 and dop853"),
    "heyoka": Peer("heyoka", "with_heyoka", ("flow", "impact"), "`var_ode_sys`, `taylor_adaptive`, QR by NumPy"),
    "pynamicalsys": Peer("pynamicalsys", "with_pynamicalsys", ("flow", "map"), "`lyapunov`, QR, rk4 and rk45"),
    "chaotax": Peer("chaotax", "with_chaotax", ("flow", "map"), "`lyapunov_spectrum` of an RK4 step, `jax.jit`"),
    "numba": Peer("numba", "with_numba", ("flow", "map", "impact"), "loops written by hand: RK4, Dormand–Prince"),
    "scipy": Peer("scipy", "with_scipy", ("flow", "map", "impact"), "`solve_ivp` and NumPy's QR", compiles=False),
    "diffrax": Peer("diffrax", "with_diffrax", ("impact",), "`diffeqsolve(event=…)` in a scan"),
}
