"""Systems whose exponents have known derivatives; what every method says of them.

``python tests/support/known_gradients.py`` prints the table: derivative, error, truth, how many
errors lie between, and trust.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special

import lyaphybrid as lh

CIRCLE = 2 * np.pi
SHEAR = np.array([[1.0, 0.4, 0.2], [0.3, 1.2, -0.5], [0.1, 0.2, 0.9]])
TORUS = {"turn": 2.3, "rate": -0.4, "depth": 0.3, "skew": 0.5}
METHODS = ("implicit", "birkhoff", "linear_response", "regression")
ROUNDING = 1e-8  # of derivatives that have no other error


def logistic(n, x, r):
    return r * x * (1 - x)


def complex_pair(n, x, theta):
    size, angle, third = 0.9 * jnp.exp(-0.3 * theta), 1 + theta, 0.3 + 0.2 * theta
    y = jnp.linalg.solve(SHEAR, x)
    turned = [jnp.cos(angle) * y[0] - jnp.sin(angle) * y[1], jnp.sin(angle) * y[0] + jnp.cos(angle) * y[1]]
    return SHEAR @ jnp.stack([size * turned[0], size * turned[1], third * y[2]])


def sheared_hopf(t, u, mu):
    a = np.array([[1.0, 0.5], [0.0, 1.3]])
    z = a @ u
    square = z @ z
    turning = 1 + 0.7 * square
    swirl = jnp.stack([(mu - square) * z[0] - turning * z[1], (mu - square) * z[1] + turning * z[0]])
    return jnp.linalg.solve(a, swirl)


def torus(n, x, args):
    """The phase turns evenly; ln of what contracts y is rate + depth cos(φ + skew sin φ), of mean rate − depth J₁."""
    phi, y = x
    rate = args["rate"] + args["depth"] * jnp.cos(phi + args["skew"] * jnp.sin(phi))
    return jnp.stack([phi + args["turn"], jnp.exp(rate) * y + jnp.sin(phi)])


def tent(n, x, s):
    """λ = ln s."""
    return s * jnp.minimum(x, 1 - x)


def skew_tent(n, x, p):
    """λ = −p ln p − (1 − p) ln(1 − p)."""
    return jnp.where(x < p, x / p, (1 - x) / (1 - p))


def beta_map(n, x, beta):
    """λ = ln β."""
    return jnp.mod(beta * x, 1.0)


def boole(n, x, a):
    """The invariant density is Cauchy's, of width 1/√(1 − a): λ = 2 ln(√a + √(1 − a))."""
    return a * x - 1 / x


def blaschke(n, x, a):
    """A circle map whose invariant density is constant: λ = ln(1 + √(1 − a²))."""
    return jnp.mod(2 * x + 2 * jnp.arctan2(a * jnp.sin(x), 1 - a * jnp.cos(x)), CIRCLE)


def solenoid(n, u, a):
    """Over that circle map; its fibres contract by 0.4 and 0.25."""
    phi, y, z = u
    along = 0.4 * y + 0.5 * jnp.cos(phi) + 0.3 * z + 0.1 * jnp.sin(phi)
    return jnp.stack([blaschke(n, phi, a), along, 0.25 * z + 0.5 * jnp.sin(phi)])


def of_solenoid(a):
    """dλ/da of the solenoid; the first of the circle map too."""
    root = np.sqrt(1 - a**2)
    return [-a / (root * (1 + root)), 0, 0]


def of_spring_damper(args):
    """Example 5.1 of Linh et al.; with p = 1/m, l = r²/J and q = l/(l + p): λ² + 3 d p q λ + k p q = 0."""
    push, lever = 1 / args["mass"], args["radius"] ** 2 / args["inertia"]
    share = push * lever / (lever + push)
    drag = 3 * args["damping"] * share
    root = jnp.sqrt(drag**2 - 4 * args["stiffness"] * share)
    return jnp.stack([-drag + root, -drag - root]) / 2


def scaled(x, c):
    """tan(x/2) → c tan(x/2)."""
    return 2 * jnp.arctan2(c * jnp.sin(x / 2), jnp.cos(x / 2))


def conjugate(n, x, c):
    """Twice the angle, seen through that change of the circle: λ = ln 2 whatever c is."""
    return scaled(2 * scaled(x, 1 / c), c)


def perturbed_cat(n, x, theta):
    p, q = x
    kick = theta * (jnp.sin(CIRCLE * p) + 0.5 * jnp.cos(CIRCLE * (p + q))) / CIRCLE
    return jnp.mod(jnp.stack([2 * p + q + kick, p + q + 0.7 * kick + 0.1 * jnp.sin(CIRCLE * q) / CIRCLE]), 1.0)


def baker(n, u, p):
    """λ₁ = −p ln p − (1 − p) ln(1 − p) = −λ₂: the discontinuity moves."""
    x, y = u
    return jnp.where(x < p, jnp.stack([x / p, p * y]), jnp.stack([(x - p) / (1 - p), p + (1 - p) * y]))


def faster_lorenz(t, x, c):
    """F → c f multiplies all exponents by c."""
    return c * lh.zoo.lorenz63().system.field(t, x, {"sigma": 10.0, "rho": 28.0, "beta": 8 / 3})


def slower_ball(t, x, c):
    """The impact oscillator with its time multiplied: x' = c f(c t, x)."""
    return c * jnp.stack([x[1], -x[0] - 0.04 * x[1] + jnp.cos(2.65 * c * t)])


WALL = lh.Transition(guard=lambda t, x, c: -x[0], reset=lambda t, x, c: x * jnp.array([1.0, -0.8]))
IMPACTS = lh.zoo.impact_oscillator(omega=2.65, zeta=0.02, restitution=0.8, gap=0.0)
LORENZ = lh.zoo.lorenz63()
FIXED = lh.RungeKutta("rk4", dt=0.01)


class Known(NamedTuple):
    """A system, the derivatives of its exponents, and which methods are to be trusted with it."""

    system: Any
    x0: Any
    args: Any
    exact: Any  # (k,), or by name of the parameter
    options: dict
    trusted: tuple[str, ...]
    error: float = 0.0  # of what is known
    own: Callable | None = None  # found -> exact, where it is the exponents themselves


ENTROPY = float(np.log(0.7 / 0.3))  # d/dp of −p ln p − (1 − p) ln(1 − p) at 0.3
BOOLE = float((0.3**-0.5 - 0.7**-0.5) / (0.3**0.5 + 0.7**0.5))
BESSEL = {
    "rate": [0, 1],
    "depth": [0, -scipy.special.j1(0.5)],
    "skew": [0, -0.3 * scipy.special.jvp(1, 0.5)],
    "turn": [0, 0],
}
OF_IMPACTS = {"restitution": -0.62349532, "zeta": -1.1113622, "omega": 30.823826, "gap": 63.364941}
REGULAR, CHAOTIC, BROKEN = ("implicit", "birkhoff"), ("linear_response", "regression"), ("regression",)

KNOWN = {
    "logistic, fixed point": Known(lh.Map(logistic), [0.3], 2.9, [1 / 0.9], {"t1": 2000}, REGULAR),
    "logistic, 2-cycle": Known(
        lh.Map(logistic), [0.3], 3.3, [(1 - 3.3) / (4 + 6.6 - 3.3**2)], {"t1": 2000, "period": 2}, REGULAR
    ),
    "complex pair": Known(
        lh.Map(complex_pair), [0.1, 0.2, 0.3], 0.2, [-0.3, -0.3, 0.2 / 0.34], {"t1": 4000, "transient": 100}, REGULAR
    ),
    "sheared Hopf": Known(
        lh.Flow(sheared_hopf), [0.9, 0.0], 0.8, [0, -2], {"t1": 500.0, "transient": 50.0}, REGULAR
    ),
    "impact oscillator": Known(
        IMPACTS.system, IMPACTS.x0, IMPACTS.args, OF_IMPACTS,
        {"t1": 2000.0, "transient": 300.0, "k": 1, "period": lambda args: 2 * jnp.pi / args["omega"],
         "over": list(OF_IMPACTS)}, ("implicit",), 1e-6,
    ),
    "faster impact oscillator": Known(
        lh.Hybrid(slower_ball, WALL), [0.0, -0.5], 1.0, None,
        {"t1": 2000.0, "transient": 300.0, "period": lambda c: 2 * jnp.pi / 2.65 / c}, ("implicit", "regression"),
        own=lambda found: found.value,
    ),
    "torus": Known(lh.Map(torus), [0.3, 0.1], TORUS, BESSEL, {"t1": 4000, "transient": 200}, ("birkhoff",)),
    "tent": Known(lh.Map(tent), [0.3], 1.7, [1 / 1.7], {"t1": 10_000, "window": 0.01, "degree": 5}, BROKEN),
    "skew tent": Known(lh.Map(skew_tent), [0.31234], 0.3, [ENTROPY], {"t1": 20_000, "window": 0.2}, BROKEN),
    "β map": Known(lh.Map(beta_map), [0.31234], 2.7, [1 / 2.7], {"t1": 10_000, "window": 0.01, "degree": 5}, BROKEN),
    "baker": Known(lh.Map(baker), [0.31234, 0.1], 0.3, [ENTROPY, -ENTROPY], {"t1": 20_000, "window": 0.2}, BROKEN),
    "Boole": Known(lh.Map(boole), [0.3], 0.3, [BOOLE], {"t1": 20_000}, BROKEN),
    "circle map": Known(lh.Map(blaschke), [0.3], 0.4, of_solenoid(0.4)[:1], {"t1": 20_000, "window": 0.4}, CHAOTIC),
    "circle in other coordinates": Known(lh.Map(conjugate), [0.3], 1.5, [0], {"t1": 20_000}, CHAOTIC),
    "solenoid": Known(lh.Map(solenoid), [0.3, 0.1, 0.2], 0.4, of_solenoid(0.4), {"t1": 20_000, "window": 0.4}, CHAOTIC),
    "cat": Known(
        lh.Map(perturbed_cat), [0.3, 0.1], 0.4, [-0.04806, 0.01293], {"t1": 50_000, "window": 0.25}, CHAOTIC, 3.2e-4
    ),
    "Lorenz": Known(
        LORENZ.system, LORENZ.x0, LORENZ.args, {"rho": [0.0242, 0, -0.0243]},
        {"t1": 300.0, "transient": 30.0, "over": ["rho"], "method": FIXED}, CHAOTIC, 2e-4,
    ),
    "faster Lorenz": Known(
        lh.Flow(faster_lorenz), LORENZ.x0, 1.0, [0.9056, 0, -14.5723],
        {"t1": 200.0, "transient": 30.0, "method": FIXED}, CHAOTIC, 1e-4,
    ),
}  # fmt: skip


def estimated(name: str, method: str):
    """What a method finds; None where it refuses."""
    case = KNOWN[name]
    options = {"key": jax.random.key(3), "transient": 1000} | case.options
    try:
        return lh.lyapunov_gradient(case.system, case.x0, case.args, algorithm=method, **options)
    except (ValueError, lh.NoDerivativeError):
        return None


def wrong_by(name: str, found) -> float:
    """The largest difference from the truth in standard errors, what is known having its own."""
    case = KNOWN[name]
    exact = case.exact if case.own is None else case.own(found)
    parts = exact if isinstance(exact, dict) else {None: exact}
    worst = 0.0
    for parameter, truth in parts.items():
        slope, error = (tree if parameter is None else tree[parameter] for tree in (found.gradient, found.stderr))
        truth = np.asarray(truth, float)
        floor = np.hypot(case.error, ROUNDING) * np.maximum(1.0, np.abs(truth))
        worst = max(worst, float(np.max(np.abs(slope - truth) / np.hypot(error, floor))))
    return worst


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    for name in KNOWN:
        for method in METHODS:
            found = estimated(name, method)
            if found is None:
                print(f"{name:28s} {method:16s} refused")
                continue
            verdict = "trusted" if found.trust else "NOT trusted: " + "; ".join(found.reasons)
            print(f"{name:28s} {method:16s} {wrong_by(name, found):8.2g} errors away, {verdict}", flush=True)
