"""Symplectic schemes for H = A + B; the derivative of their step is the tangent-map method.

A step applies the exact flows of the parts one after the other. For H = T(p) + V(q) these are drifts and kicks
(`Symplectic`); `Splitting` takes any flows that are known in closed form.
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from ..._arguments import is_one_of, positive, require
from ..._jax.columns import each_column
from ..._jax.jaxprs import jacobian
from ..._linalg.frames import log_abs_det
from ...native import instructions
from ...systems.hamiltonians import SeparableField, halves
from ..base import Method, Step, Tangent
from ..runge_kutta import hermite
from .fitting_parts import MOVES_TIME, require_flows_of
from .splittings import COMPOSITIONS, PART_A, SCHEMES, Scheme, composed

__all__ = ["Composition", "Splitting", "Symplectic", "moved", "separable", "with_columns"]


class Composition(Method):
    """Base class of fixed-step methods that compose exact flows."""

    dt: eqx.AbstractVar[Any]
    rtol: ClassVar[float] = 0.0
    atol: ClassVar[float] = 0.0
    control: ClassVar[str] = "x"

    @property
    def fixed_step(self) -> Any:
        """The step, in units of time."""
        return self.dt

    @property
    def error_order(self) -> int:
        """1, without meaning: there is no error estimate."""
        return 1

    def inside(self, dense, theta):
        """The cubic Hermite interpolant of the step at the fraction theta."""
        x0, f0, x1, f1, h = dense
        return hermite(theta, x0, h * f0, x1, h * f1)

    def _arrived(self, field: Any, t, x, f, h, new) -> Step:
        slope = field(t + h, new)
        return Step(new, slope, x[None, :0], (x, f, new, slope, h), (t, x))


class Symplectic(Composition):
    """A symplectic scheme for an `lh.Hamiltonian`, H = T(p) + V(q), with a fixed step.

    The tangent map is the derivative of the step itself, one Hessian–vector product for each kick and column; so it is
    symplectic too, and exponents come in pairs. A potential that depends on time takes it as one more coordinate τ, and
    T(p) + p_τ moves it, τ' = 1.

    Args:
        scheme: "leapfrog", "ForestRuth", "SABA1" … "SABA10", "SBAB1" … "SBAB10", the same with a corrector ("SABA2C",
            …), "ABA864", "ABA1064", "BlanesMoan4", "BlanesMoan6", "SRKN11b", "SRKN14a", "Yoshida6", "SuzukiUmeno8".
            Correctors and SRKN need a kinetic energy that is quadratic in p. The default, SRKN11b, was the cheapest for
            relative errors of the energy of 1e-6 to 1e-10 in ``python -m benchmarks.work_precision``.
        dt: the step, in units of time. It is shortened at events and at the ends of blocks.

    Raises:
        ValueError: on an unknown scheme, on a step that is not positive; and, where it is used, on a system that is
            no `lh.Hamiltonian`, or whose kinetic energy the scheme does not fit.

    Source:
        Ch. Skokos & E. Gerlach, Phys. Rev. E 82 (2010) 036704, doi:10.1103/PhysRevE.82.036704; that of each scheme is
        in ``lyaphybrid.integrators.hamiltonian.splittings.SCHEMES[scheme].source``.

    Example:
        >>> import lyaphybrid as lh
        >>> lh.Symplectic("SBAB2C", dt=0.05).adaptive
        False
    """

    scheme: str = eqx.field(static=True)
    dt: Any

    def __init__(self, scheme: str = "SRKN11b", dt: Any = None):
        require(is_one_of(scheme, SCHEMES), f"Unknown scheme {scheme!r}; the schemes are {', '.join(SCHEMES)}.")
        require(dt is not None, f"A symplectic scheme needs its step: lh.Symplectic({scheme!r}, dt=…).")
        positive("dt", dt)
        self.scheme, self.dt = scheme, dt

    def require(self, field: Any, t, x) -> None:
        """Raise a ValueError unless the field is that of an `lh.Hamiltonian` whose kinetic energy fits the scheme."""
        parts = separable(field, x, f"lh.Symplectic({self.scheme!r})")
        if SCHEMES[self.scheme].quadratic:
            parts.require_quadratic(field.args, halves(x)[1], f"lh.Symplectic({self.scheme!r})")

    def step(self, field: Any, t, x, f, h) -> Step:
        """One step over h from (t, x)."""
        return self._arrived(field, t, x, f, h, moved(SCHEMES[self.scheme], field, x, h))

    def tangent(self, field: Any, t, x, h, frame, stage_points=()) -> Tangent:
        """The tangent map: drifts and kicks of the columns, linearised along the path of the state."""
        del stage_points
        new, columns = moved(SCHEMES[self.scheme], field, (x, frame), h, with_columns)
        return Tangent(new, columns, frame[None, :0], (t, x))

    def divergence(self, field, nodes, h):
        """Zero: a symplectic map conserves phase-space volume."""
        return jnp.zeros_like(h)


def moved(scheme: Scheme, field: Any, state: Any, h, at: Callable = lambda function, x: function(x)):
    """The state (2m,) after a step over h of a scheme, for the field of H = T + V.

    The state may be a pytree of arrays (2m, …); `at(function, x)` then evaluates a function of (m,) on such a pytree.
    """
    parts, args = field.field, field.args
    q, p = (jax.tree.map(lambda one, half=half: halves(one)[half], state) for half in (0, 1))

    def velocity(share):
        return scaled(share * h, at(lambda p: parts.velocity(p, args), p))

    def push(share):
        return scaled(share * h, at(lambda q: parts.force(q, args), q))

    def correction():
        return scaled(scheme.corrector * h**3, at(lambda q: parts.slope_of_bracket(q, args), q))

    def scaled(factor, tree):
        return jax.tree.map(lambda one: factor * one, tree)

    def plus(tree, *changes):
        return jax.tree.map(lambda one, *others: sum(others, one), tree, *changes)

    if scheme.corrector and scheme.parts[0][0] == PART_A:
        p = plus(p, correction())
    for i, (part, share) in enumerate(scheme.parts):
        if part == PART_A:
            q = plus(q, velocity(share))
        elif scheme.corrector and i == 0:
            p = plus(p, push(share), correction())
        else:
            p = plus(p, push(share))
    if scheme.corrector:
        p = plus(p, correction())
    return jax.tree.map(lambda *two: jnp.concatenate(two), q, p)


def with_columns(function: Callable, point: tuple) -> tuple:
    """The value (m,) of a function at x (m,), and its derivative there applied to columns (m, k).

    A derivative that costs more than a product with a matrix (m, m) is computed as a Jacobian matrix once, and the
    columns are multiplied by it.
    """
    x, columns = point
    value, linear = jax.linearize(function, x)
    if instructions(jax.make_jaxpr(linear)(x).jaxpr) <= 2 * x.size**2:
        return value, each_column(linear, columns)
    return value, jacobian(function, x) @ columns


def separable(field: Any, x, name: str) -> SeparableField:
    """The parts T and V of a field; a ValueError if it is not that of an `lh.Hamiltonian`."""
    parts = field.field
    require(
        isinstance(parts, SeparableField),
        f"{name} moves the two parts of lh.Hamiltonian(kinetic, potential) in turn; got another field. For that take "
        "lh.RungeKutta, or lh.Splitting with the flows of its parts if it is the only mode.",
    )
    require(x.shape[0] % 2 == 0, f"The state of an lh.Hamiltonian is (q, p), an even number; got {x.shape[0]}.")
    return parts


class Splitting(Composition):
    """A splitting scheme for H = A + B + …, or any dx/dt = a + b + …, with parts whose flows are in closed form.

    Parts may depend on time, t' = 1, which is one more variable and moves with the first part alone: schemes then keep
    their order.

    Args:
        flows: two functions or more, ``(dt, t, x, args) -> x``: the state after the time dt under one part alone, from
            x at the time t. Of dx/dt = a(t, x) + b(t, x) + … the first solves x' = a(s, x) while s goes from t to
            t + dt; the others solve x' = b(t, x) with t held fixed, as a kick x + dt b(t, x) does.
        coefficients: the name of a scheme as for `lh.Symplectic`, without corrector; of more than two parts
            "leapfrog", "ForestRuth", "Yoshida6" or "SuzukiUmeno8". Or a sequence of pairs (which of the flows,
            fraction of the step), in the order in which they act.
        dt: the step, in units of time.

    Raises:
        ValueError: if the flows are not two functions or more, on an unknown scheme or one with a corrector or for
            T + V only, on fractions of a flow that do not sum to 1, on a step that is not positive; where it is used,
            on a system with several modes, whose flows differ, and, at the start and a step later, on flows whose
            velocities do not add up to the field and on flows that do not treat the time as said above.

    Source:
        J. Laskar & P. Robutel, Celest. Mech. Dyn. Astron. 80 (2001) 39, doi:10.1023/A:1012098603882; of three parts
        Ch. Skokos, E. Gerlach, J. D. Bodyfelt, G. Papamikos & S. Eggl, Phys. Lett. A 378 (2014) 1809,
        doi:10.1016/j.physleta.2014.04.050; parts that depend on time: S. Blanes & F. Casas, A Concise Introduction to
        Geometric Numerical Integration (CRC Press 2016), doi:10.1201/b21563.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> drift = lambda dt, t, x, args: jnp.stack([x[0] + dt * x[1], x[1]])
        >>> kick = lambda dt, t, x, args: jnp.stack([x[0], x[1] - dt * jnp.sin(x[0])])
        >>> method = lh.Splitting((drift, kick), "ABA864", dt=0.1)
        >>> pendulum = lh.Flow(lambda t, x, args: jnp.stack([x[1], -jnp.sin(x[0])]))
        >>> lh.trajectory(pendulum, [1.0, 0.0], t1=10.0, method=method).x.shape
        (1000, 2)
    """

    of_one_mode: ClassVar[bool] = True

    flows: tuple[Callable, ...]
    parts: tuple[tuple[int, float], ...] = eqx.field(static=True)
    dt: Any

    def __init__(self, flows: Sequence[Callable], coefficients: str | Sequence[tuple[int, float]], dt: Any):
        good = len(flows) >= 2 and all(map(callable, flows))
        require(good, f"flows must be two functions or more; got {flows!r}.")
        positive("dt", dt)
        self.flows, self.dt = tuple(flows), dt
        self.parts = _parts(coefficients, len(flows))

    def require_at_start(self, field: Any, t, x, args) -> None:
        """Raise a ValueError where the flows are seen not to be those of the field."""
        require_flows_of(field, self, t, x, args)

    def step(self, field: Any, t, x, f, h) -> Step:
        """One step over h from (t, x)."""
        new, passed = x, 0.0
        for part, share in self.parts:
            new = self.flows[part](share * h, t + passed * h, new, field.args)
            passed += share if part == MOVES_TIME else 0.0
        return self._arrived(field, t, x, f, h, new)

    def divergence(self, field, nodes, h):
        """ln|det| of the step's derivative: the divergences of the parts are not given separately."""
        t, x = nodes
        return log_abs_det(jax.jacfwd(lambda x: self.step(field, t, x, field(t, x), h).x)(x))


def _parts(coefficients, flows: int) -> tuple[tuple[int, float], ...]:
    if isinstance(coefficients, str):
        two = [name for name, scheme in SCHEMES.items() if not scheme.corrector and not scheme.quadratic]
        fit, count = (two, "two") if flows == 2 else (list(COMPOSITIONS), flows)
        require(
            coefficients in fit,
            f"No scheme {coefficients!r} for {count} general parts; the schemes are {', '.join(fit)}.",
        )
        return SCHEMES[coefficients].parts if flows == 2 else composed(COMPOSITIONS[coefficients], flows)
    parts = tuple((int(part), float(share)) for part, share in coefficients)
    for flow in range(flows):
        total = sum(share for part, share in parts if part == flow)
        require(abs(total - 1) < 1e-9, f"The fractions of flow {flow} must sum to 1; they sum to {total}.")
    known = all(part in range(flows) for part, _ in parts)
    require(known, f"coefficients name the flows 0 to {flows - 1}; got {coefficients!r}.")
    return parts
