"""Derivatives of exponents of regular motion without an isolated periodic orbit: tori, families of orbits.

The derivatives of ln R_ii along an orbit are averaged with smooth (Birkhoff) weights,

    λ_i = Σ w_j ln R_ii,j / Σ w_j τ_j

over blocks of length τ_j. With equal weights the average would not converge: where a frequency depends on θ, the
derivative of the phase grows with t, and so do oscillating terms. Weights that vanish with all derivatives at both ends
average them to zero faster than any power of 1/t, if a block's growth is a smooth function on the torus. So with jumps
the blocks end at jumps: between two fixed times the number of jumps would vary.

S. Das, Y. Saiki, E. Sander & J. Yorke, Nonlinearity 30 (2017) 4111, doi:10.1088/1361-6544/aa84c2.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import compiled
from ...integrators import RungeKutta
from ...results.averages import birkhoff_weights
from ...results.spectrum import doubtful
from ...statuses import STATUS
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.smooth import Flow, Map
from ..spectra import lyapunov_spectrum
from .estimates import Estimate, ExponentFunction, UntrustedError, with_arrays

__all__ = ["by_birkhoff"]

FLOW_BLOCKS = 2000  # of a flow
MOST_JUMP_BLOCKS = 20_000  # of a map, or of motion with jumps; up to this number each iteration or jump is a block
FEWEST_JUMPS = 100  # jumps in a run from which on blocks end at jumps
EXPLODES = 20.0  # λ₁t₁ beyond which the motion counts as chaotic and no derivative is taken
HALVES_AGREE = 1e-4  # largest relative difference of the derivatives from a run and from its first half
CHEAPER = 4  # a reverse derivative is taken to cost as much as this many forward ones


class ExponentsOfRun(eqx.Module):
    """Exponents along one run as a function of the parameters."""

    system: Any
    start: Any  # args ↦ (n,)
    args_of: Any  # θ ↦ args
    k: int
    options: dict[str, Any]

    def run(self, theta, progress=None):
        """The spectrum of the run."""
        args = self.args_of(theta)
        return lyapunov_spectrum(
            self.system, self.start(args), args, k=self.k, throw=False, progress=progress, **self.options
        )

    def means(self, theta, clock: str):
        """Exponents (2, k) from the whole run and from its first half."""
        history = self.run(theta).history
        reading = history.time if self.options["clock"] == clock else history.elapsed
        assert reading is not None, "a run knows its times"
        duration = jnp.diff(reading, prepend=0.0)
        blocks = len(duration)
        return jnp.stack([_mean(history.growth[:count], duration[:count]) for count in (blocks, blocks // 2)])


def _mean(growth, duration):
    weights = birkhoff_weights(jnp, (jnp.arange(len(duration), dtype=duration.dtype) + 0.5) / len(duration))
    return weights @ growth / (weights @ duration)


def by_birkhoff(case: ExponentFunction, *, progress: Any = None) -> Estimate:
    """Exponents and their derivatives along one run.

    Args:
        case: with the options of `lyapunov_spectrum`.
        progress: None, True for a bar, or a function of the fraction done, of the first run, without derivatives.

    Raises:
        UntrustedError: where the motion is chaotic, or the run failed.
    """
    options: dict[str, Any] = {**case.options, "blocks": FLOW_BLOCKS}
    if options.get("method") is None and isinstance(case.system, Flow | Hybrid):
        options["method"] = RungeKutta("dopri8", rtol=1e-11, atol=1e-13)
    along, theta = ExponentsOfRun(case.system, case.start, case.args_of, case.k, options), jnp.asarray(case.theta)
    found, clock = along.run(theta, progress), options["clock"]
    if int(found.status_code) != int(STATUS.ok):
        raise UntrustedError(f"the run failed: {found.status}.", failed=True)
    if doubtful(found):
        raise UntrustedError(f"the exponents may be wrong: {', '.join(sorted(found.notes))}.")
    if found.exponents[0] * found.history.time[-1] > EXPLODES:
        growth = f"e^{found.exponents[0] * found.history.time[-1]:.3g}"
        raise UntrustedError(f"the motion is chaotic: over the run the derivative of a trajectory grows by {growth}.")
    if 0 < found.jumps < FEWEST_JUMPS and clock == "time" and not isinstance(case.system, Map):
        raise UntrustedError(
            f"{int(found.jumps)} jumps, fewer than {FEWEST_JUMPS}: blocks of equal times see no change of the number "
            "of jumps with a parameter; a longer t1 gives blocks of equal numbers of jumps."
        )
    along = eqx.tree_at(lambda along: along.options, along, with_arrays(options | _blocks(case, found), theta.dtype))
    reverse = len(theta) > CHEAPER * 2 * case.k and not isinstance(case.system, EventDriven)
    return _judged(case, *_with_derivatives(along, theta, clock, reverse))


def _blocks(case: ExponentFunction, found) -> dict:
    """Blocks of equal numbers of iterations or jumps, where there are any."""
    if isinstance(case.system, Map):
        count, others = int(case.options["t1"]), {}
    elif found.jumps >= FEWEST_JUMPS and case.options["clock"] == "time":
        count, each = int(found.jumps), float(found.jumps) / float(found.time)
        others = {"transient": float(np.ceil(each * case.options["transient"])), "clock": "jumps"}
    else:
        return {}
    size = math.ceil(count / MOST_JUMP_BLOCKS)
    blocks = count // size if isinstance(case.system, Map) else _rounded(count // size)
    return {"t1": float(blocks * size), "blocks": max(2, blocks), **others}


def _rounded(count: int) -> int:
    """The number of blocks rounded down, so that runs with slightly different numbers compile nothing new."""
    step = 2 ** max(0, math.floor(math.log2(count)) - 3)
    return count // step * step


@compiled(lambda along, *rest: along.k, hands_on=True)
def _with_derivatives(along: ExponentsOfRun, theta, clock: str, reverse: bool):
    def means(theta):
        return (along.means(theta, clock),) * 2

    slopes, both = (jax.jacrev if reverse else jax.jacfwd)(means, has_aux=True)(theta)
    return both, slopes


def _judged(case: ExponentFunction, both: np.ndarray, slopes: np.ndarray) -> Estimate:
    """The estimate from exponents (2, k) and derivatives (2, k, p) of the run and of its first half."""
    (value, half), (gradient, shorter) = both, slopes
    apart, largest = np.abs(gradient - shorter), np.max(np.abs(value))
    scale = np.max([np.max(np.abs(gradient), axis=0), largest / np.maximum(1, np.abs(case.theta))], axis=0)
    worst = float(np.max(apart / np.maximum(scale, HALVES_AGREE)))
    reason = f"derivatives from the run and from its first half differ by {worst:.2g} of the largest"
    return Estimate(value, np.abs(value - half), gradient, apart, worst <= HALVES_AGREE, (reason,), 2 + len(case.theta))
