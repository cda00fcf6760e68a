"""Differential–algebraic systems: E(t) x' = f(t, x) with constraints, smooth and with switches."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.tracing import numpy_for, traced
from ...systems.daes.semi_linear import DAE
from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, computed, exact, near, positive, problem, require, state
from .smooth import lorenz63

LINH = "V. H. Linh, N. D. Truong & P. Q. Tuyen, DAE Panel 3 (2025), doi:10.52825/dae-p.v3i.2632"
DAMPED = (-0.17712434446770464, -2.8228756555322954)  # (−3 ± √7)/2


def _semi_explicit(d: int, n: int):
    """E = diag(1, …, 1, 0, …, 0)."""
    leading = np.diag(np.arange(n) < d).astype(float)
    return lambda t, args: jnp.asarray(leading)


def _spring_damper(t, x, args):
    a, b, c, force = x[0], x[1], x[2], x[3]
    radius, damping, push = args["radius"], args["damping"], 1 / args["mass"]
    lever = radius**2 / args["inertia"]
    spring = (args["stiffness"] * push + args["cubic"] * push * a**2) * a
    return jnp.stack(
        [
            b,
            -spring - damping * push * b + push * force,
            b - radius * c,
            -spring + (2 * lever - push) * damping * b + (lever + push) * force,
        ]
    )


def _plain_parts(x):
    """F and g of Example 5.2."""
    force = -x[0] - x[0] ** 3
    return jnp.stack([x[1], force - 2 * x[1] + x[3]]), jnp.stack([x[1] - 2 * x[2], force + 2 * x[1] + 2 * x[3]])


def _givens(t, args):
    """Q(t) of Example 5.2."""
    c2, s2, c3, s3 = (f(args[g] * t) for g in ("gamma2", "gamma3") for f in (jnp.cos, jnp.sin))
    zero = jnp.zeros_like(c2)
    rows = [[c2, zero, zero, s2], [zero, c3, s3, zero], [zero, -s3, c3, zero], [-s2, zero, zero, c2]]
    return jnp.stack([jnp.stack(row) for row in rows])


def _turning(t, args):
    """E₁₁(t) of Example 5.2."""
    c, s = jnp.cos(args["gamma1"] * t), jnp.sin(args["gamma1"] * t)
    return jnp.stack([jnp.stack([c, s]), jnp.stack([-s, c])])


def _rotated_leading(t, args):
    return jnp.concatenate([_turning(t, args) @ _givens(t, args)[:2], jnp.zeros((2, 4), t.dtype)])


def _rotated(t, y, args):
    turned, moving = jax.jvp(lambda t: _givens(t, args), (t,), (jnp.ones_like(t),))
    slope, constraint = _plain_parts(turned @ y)
    return jnp.concatenate([_turning(t, args) @ (slope - moving[:2] @ y), constraint])


def _lorenz(t, x, args):
    a, b, c, product = x[0], x[1], x[2], x[3]
    return jnp.stack([args["sigma"] * (b - a), a * (args["rho"] - c) - b, product - args["beta"] * c, product - a * b])


def _pendulum(t, x, args):
    a, b, u, v, tension = x[0], x[1], x[2], x[3], x[4]
    torque = args["amplitude"] * jnp.cos(args["omega"] * t)
    drag = args["damping"]
    return jnp.stack(
        [
            u,
            v,
            -drag * u - tension * a - torque * b,
            -1 - drag * v - tension * b + torque * a,
            u**2 + v**2 - drag * (a * u + b * v) - tension * (a**2 + b**2) - b,
        ]
    )


def _rectifier(conducts: bool):
    def residual(t, x, args):
        charge, voltage, current = x[0], x[1], x[2]
        drop = args["amplitude"] * jnp.sin(args["omega"] * t) - voltage
        return jnp.stack(
            [
                current - voltage / args["resistance"],
                charge - args["capacitance"] * voltage,
                args["on_resistance"] * current - drop if conducts else current,
            ]
        )

    return residual


def _swing(t, x, args):
    angle, speed, phase, voltage = x[0], x[1], x[2], x[3]
    emf, near_side, far_side = args["emf"], args["generator_reactance"], args["line_reactance"]
    given = emf * voltage / near_side * jnp.sin(angle - phase)
    reactive = (emf * jnp.cos(angle - phase) - voltage) / near_side + (jnp.cos(phase) - voltage) / far_side
    return jnp.stack(
        [
            speed,
            (args["power"] - given - args["damping"] * speed) / args["inertia"],
            given - voltage / far_side * jnp.sin(phase) - args["load"],
            voltage * reactive - args["reactive_load"],
        ]
    )


SPRING_DAMPER = DAE(_semi_explicit(2, 4), _spring_damper, 2)
ROTATED = DAE(_rotated_leading, _rotated, 2)
LORENZ_DAE = DAE(_semi_explicit(3, 4), _lorenz, 3, names=("x", "y", "z", "xy"))
PENDULUM_DAE = DAE(_semi_explicit(4, 5), _pendulum, 4, names=("x", "y", "u", "v", "tension"))
RECTIFIER = Hybrid(
    {
        "conducting": DAE(_semi_explicit(1, 3), _rectifier(True), 1),
        "blocked": DAE(_semi_explicit(1, 3), _rectifier(False), 1),
    },
    [
        Transition(lambda t, x, args: x[2], source="conducting", target="blocked"),
        Transition(
            lambda t, x, args: x[1] - args["amplitude"] * jnp.sin(args["omega"] * t),
            source="blocked",
            target="conducting",
        ),
    ],
    names=("charge", "voltage", "current"),
)
SWING = DAE(_semi_explicit(2, 4), _swing, 2, names=("angle", "speed", "phase", "voltage"))


@problem
def spring_damper_dae(
    *,
    stiffness: Real = 1.0,
    cubic: Real = 1.0,
    damping: Real = 2.0,
    radius: Real = 2.0,
    mass: Real = 1.0,
    inertia: Real = 4.0,
) -> Problem:
    """Example 5.1 of Linh et al.: a mass on a nonlinear spring, with a damper and a disk that rolls without slip.

    x₁' = x₂, M x₂' = −k₁x₁ − k₂x₁³ − b x₂ + x₄ with the constraints x₂ = r x₃ and one for the force x₄. The motion
    decays to rest, and the exponents are the eigenvalues there, (−3 ± √7)/2 at the default parameters.

    Args:
        stiffness: k₁.
        cubic: k₂.
        damping: b.
        radius: r, positive.
        mass: M, positive.
        inertia: J, positive.

    Returns:
        A `Problem`; at the default parameters with the exact reference.

    Source:
        Example 5.1 of V. H. Linh, N. D. Truong & P. Q. Tuyen, DAE Panel 3 (2025), doi:10.52825/dae-p.v3i.2632, after P.
        Di Franco, G. Scarciotti & A. Astolfi, IEEE/CAA J. Autom. Sin. 7 (2020) 929.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.spring_damper_dae().system.n_differential
        2
    """
    positive(radius=radius, mass=mass, inertia=inertia)
    values = (stiffness, cubic, damping, radius, mass, inertia)
    force = -_spring_damper(0.0, (1.0, 1.0, 1.0 / radius, 0.0), _named(values))[3] / (radius**2 / inertia + 1 / mass)
    return Problem(
        system=SPRING_DAMPER,
        x0=state(1.0, 1.0, 1 / radius, force),
        args=_named(values),
        t1=1000.0,
        transient=100.0,
        reference=exact(*DAMPED, source="eigenvalues at rest") if near(values, 1, 1, 2, 2, 1, 4) else None,
        source=f"{LINH}, Example 5.1",
    )


def _named(values) -> dict:
    return dict(zip(("stiffness", "cubic", "damping", "radius", "mass", "inertia"), values, strict=True))


@problem
def rotated_dae(*, gamma1: Real = 1.0, gamma2: Real = 2.0, gamma3: Real = 3.0) -> Problem:
    """Example 5.2 of Linh et al.: the damped spring in turning coordinates, x = Q(t) y.

    E depends on time, and none of its rows is that of a semi-explicit system; exponents and finite-time values are
    those of `spring_damper_dae` for all γ.

    Args:
        gamma1: rate at which E₁₁ turns.
        gamma2: rate of the first Givens rotation of Q.
        gamma3: rate of the second.

    Returns:
        A `Problem` with the exact reference.

    Source:
        Example 5.2 of V. H. Linh, N. D. Truong & P. Q. Tuyen, DAE Panel 3 (2025), doi:10.52825/dae-p.v3i.2632.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.rotated_dae(gamma1=20, gamma2=100, gamma3=200).reference)
        -0.1771243445, -2.822875656 per unit time (eigenvalues at rest)
    """
    return Problem(
        system=ROTATED,
        x0=state(1.0, 1.0, 0.5, 0.0),
        args={"gamma1": gamma1, "gamma2": gamma2, "gamma3": gamma3},
        t1=1000.0,
        transient=100.0,
        reference=exact(*DAMPED, source="eigenvalues at rest"),
        source=f"{LINH}, Example 5.2",
    )


@problem
def lorenz_dae(*, sigma: Real = 10.0, rho: Real = 28.0, beta: Real = 8 / 3) -> Problem:
    """Lorenz' system with the product xy as an algebraic variable, w = xy: four components, three exponents.

    Args:
        sigma: Prandtl number.
        rho: Rayleigh number over its critical value.
        beta: aspect ratio of the rolls.

    Returns:
        A `Problem` with the reference of `lorenz63`.

    Source:
        E. N. Lorenz, J. Atmos. Sci. 20 (1963) 130, doi:10.1175/1520-0469(1963)020<0130:DNF>2.0.CO;2.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.lorenz_dae().x0.tolist()
        [1.0, 1.0, 20.0, 1.0]
    """
    smooth = lorenz63(sigma=sigma, rho=rho, beta=beta)
    return Problem(
        system=LORENZ_DAE,
        x0=state(1.0, 1.0, 20.0, 1.0),
        args=smooth.args,
        t1=2000.0,
        transient=50.0,
        reference=smooth.reference,
        source=smooth.source,
    )


@problem
def pendulum_dae(*, damping: Real = 0.5, amplitude: Real = 1.5, omega: Real = 2 / 3) -> Problem:
    """A driven, damped pendulum, θ'' + c θ' + sin θ = A cos ωt, in Cartesian coordinates, of index one.

    The rod's tension λ is algebraic: 0 = u² + v² − c (xu + yv) − λ (x² + y²) − y says that x² + y² has no second
    derivative. So perturbations of the rod's length and of its rate neither grow nor decay, except for a factor
    t. Two of the four exponents are these spurious zeros; the others are the pendulum's, and sum to −c.

    Args:
        damping: c.
        amplitude: A.
        omega: ω, positive.

    Returns:
        A `Problem`; at the default parameters, where the motion is chaotic, with the reference 0.1140(8), 0, 0,
        −0.6140(8).

    Source:
        G. L. Baker & J. P. Gollub, Chaotic Dynamics (Cambridge 1996), doi:10.1017/CBO9781139170864.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.pendulum_dae().system.n_differential
        4
    """
    positive(omega=omega)
    known = near((damping, amplitude, omega), 0.5, 1.5, 2 / 3)
    angle = 0.2
    return Problem(
        system=PENDULUM_DAE,
        x0=state(math.sin(angle), -math.cos(angle), 0.0, 0.0, math.cos(angle)),
        args={"damping": damping, "amplitude": amplitude, "omega": omega},
        t1=4000.0,
        transient=200.0,
        reference=computed(
            (0.1140, 0.0, 0.0, -0.6140),
            (8e-4, 0.0, 0.0, 8e-4),
            source="the equation for θ; two zeros are the rod's length and its rate",
        )
        if known
        else None,
        source="G. L. Baker & J. P. Gollub, Chaotic Dynamics (Cambridge 1996), doi:10.1017/CBO9781139170864",
    )


@problem
def diode_circuit(
    *,
    resistance: Real = 10.0,
    on_resistance: Real = 1.0,
    capacitance: Real = 0.2,
    amplitude: Real = 1.0,
    omega: Real = 1.0,
) -> Problem:
    """A half-wave rectifier in charge-oriented form: q' = i − v/R with 0 = q − Cv and a diode that switches.

    Conducting: r i = A sin ωt − v, until i falls through zero; blocked: i = 0, until the source rises above v. The
    current is continuous where the diode switches, so S is one, and λ = −1/(RC) − (share of the time conducting)/(rC).

    Args:
        resistance: R of the load.
        on_resistance: r of the conducting diode and the source.
        capacitance: C.
        amplitude: A.
        omega: ω.

    Returns:
        A `Problem` in mode "blocked".

    Source:
        R. Riaza, Differential-Algebraic Systems: Analytical Aspects and Circuit Applications (World Scientific 2008),
        doi:10.1142/6746.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.diode_circuit().system.mode_names
        ('conducting', 'blocked')
    """
    positive(
        resistance=resistance, on_resistance=on_resistance, capacitance=capacitance, amplitude=amplitude, omega=omega
    )
    return Problem(
        system=RECTIFIER,
        x0=state(0.5 * capacitance, 0.5, 0.0),
        args={
            "resistance": resistance,
            "on_resistance": on_resistance,
            "capacitance": capacitance,
            "amplitude": amplitude,
            "omega": omega,
        },
        mode="blocked",
        t1=200 * math.pi / (1.0 if traced(omega) else omega),
        transient=40 * math.pi / (1.0 if traced(omega) else omega),
        source="R. Riaza, Differential-Algebraic Systems (World Scientific 2008), doi:10.1142/6746",
    )


@problem
def swing_dae(
    *,
    power: Real = 0.8,
    damping: Real = 0.1,
    inertia: Real = 0.2,
    load: Real = 0.5,
    reactive_load: Real = 0.2,
    emf: Real = 1.1,
    generator_reactance: Real = 0.4,
    line_reactance: Real = 0.3,
) -> Problem:
    """A generator that swings against a large network, with a load of constant power between them.

    δ' = ω, M ω' = P − (E V/x_g) sin(δ − θ) − D ω, and the balance of active and reactive power at the load's bus, whose
    voltage is V e^{iθ}. Beyond a certain load there is no such voltage: [E₁; ∂f₂/∂x] becomes singular, the voltage
    collapses.

    Args:
        power: P, mechanical, per unit as all others.
        damping: D.
        inertia: M, positive.
        load: active power of the load.
        reactive_load: its reactive power.
        emf: E behind the generator's reactance, positive.
        generator_reactance: x_g, positive.
        line_reactance: x_l from the load to the large network, positive.

    Returns:
        A `Problem`, started at δ = 0.5, ω = 0.

    Raises:
        ValueError: where the load is too large for the start.

    Source:
        I. A. Hiskens & D. J. Hill, IEEE Trans. Power Syst. 4 (1989) 1525, doi:10.1109/59.41705.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.swing_dae().x0.shape
        (4,)
    """
    positive(inertia=inertia, emf=emf, generator_reactance=generator_reactance, line_reactance=line_reactance)
    args = {
        "power": power,
        "damping": damping,
        "inertia": inertia,
        "load": load,
        "reactive_load": reactive_load,
        "emf": emf,
        "generator_reactance": generator_reactance,
        "line_reactance": line_reactance,
    }
    phase, voltage = _at_the_load(0.5, args)
    return Problem(
        system=SWING,
        x0=state(0.5, 0.0, phase, voltage),
        args=args,
        t1=500.0,
        transient=100.0,
        source="I. A. Hiskens & D. J. Hill, IEEE Trans. Power Syst. 4 (1989) 1525, doi:10.1109/59.41705",
    )


def _at_the_load(angle: float, args):
    """The voltage at the load: the larger of the two solutions of its power balance, with both sources combined."""
    xp = numpy_for(args)
    reactance = 1 / (1 / args["generator_reactance"] + 1 / args["line_reactance"])
    generator = args["emf"] / args["generator_reactance"] * reactance
    real = generator * xp.cos(angle) + reactance / args["line_reactance"]
    imaginary = generator * xp.sin(angle)
    half = 0.5 * (real**2 + imaginary**2) - args["reactive_load"] * reactance
    left = half**2 - reactance**2 * (args["load"] ** 2 + args["reactive_load"] ** 2)
    require("load", left, lambda v: v > 0, "small enough for the network to carry it")
    voltage = xp.sqrt(half + xp.sqrt(left))
    size = xp.sqrt(real**2 + imaginary**2)
    return xp.arctan2(imaginary, real) - xp.arcsin(args["load"] * reactance / (size * voltage)), voltage
