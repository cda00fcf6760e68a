"""Random differential-algebraic systems: known ones in coordinates that turn.

y' = Ay + f sin ωt and 0 = z + κz³ − (Cy + e cos ωt), seen as x = Q(t)(y, z), Q(t) a rotation by αt, then a fixed one;
the differential rows are mixed by a matrix L. All of y, and z by a cubic equation, is known in closed form.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

import lyaphybrid as lh

from .batches import in_batches, judged

LENGTH, DIFFERENTIAL = 3.0, 2
METHODS = {"half-explicit": lh.HalfExplicit(rtol=1e-10), "ESDIRK": lh.ESDIRK(rtol=1e-9)}
WITHIN = 1e-6  # of what is largest


def rotation(t, args, xp=jnp):
    """Q(t) (3, 3): a fixed rotation after one by αt in the plane of the first and the third component."""
    c, s = xp.cos(args["alpha"] * t), xp.sin(args["alpha"] * t)
    zero, one = xp.zeros_like(c), xp.ones_like(c)
    turn = xp.stack([xp.stack([c, zero, -s]), xp.stack([zero, one, zero]), xp.stack([s, zero, c])])
    return args["Q0"] @ turn


def leading(t, args):
    rows = args["L"] @ rotation(t, args).T[:DIFFERENTIAL]
    return jnp.concatenate([rows, jnp.zeros((1, 3))])


def residual(t, x, args):
    q, slope = jax.jvp(lambda t: rotation(t, args), (t,), (jnp.ones_like(t),))
    own = q.T @ x
    y, z = own[:DIFFERENTIAL], own[DIFFERENTIAL]
    moving = args["A"] @ y + args["f"] * jnp.sin(args["omega"] * t) - (slope.T @ x)[:DIFFERENTIAL]
    left = z + args["kappa"] * z**3 - args["C"] @ y - args["e"] * jnp.cos(args["omega"] * t)
    return jnp.concatenate([args["L"] @ moving, left[None]])


SYSTEM = lh.DAE(leading, residual, n_differential=DIFFERENTIAL)


def case(seed: int) -> dict:
    """Parameters, a consistent start, its end and the derivative of the end by y."""
    draw = np.random.default_rng(seed)
    args = {
        "A": draw.uniform(-1, 1, (2, 2)) - 0.3 * np.eye(2), "f": draw.uniform(-1, 1, 2), "C": draw.uniform(-1, 1, 2),
        "e": draw.uniform(-1, 1), "omega": draw.uniform(0.3, 3), "alpha": draw.uniform(-5, 5),
        "kappa": draw.choice([0.0, draw.uniform(0, 1)]), "L": np.eye(2) + draw.uniform(-0.4, 0.4, (2, 2)),
        "Q0": np.linalg.qr(draw.normal(size=(3, 3)))[0],
    }  # fmt: skip
    t0, y0 = draw.uniform(-2, 2), draw.uniform(-1, 1, 2)
    start, first = _lifted(t0, y0, args)
    t = t0 + LENGTH
    steady = [np.imag(np.linalg.solve(1j * args["omega"] * np.eye(2) - args["A"], args["f"] + 0j)
              * np.exp(1j * args["omega"] * s)) for s in (t0, t)]  # fmt: skip
    carried = scipy.linalg.expm(LENGTH * args["A"])
    end, last = _lifted(t, carried @ (y0 - steady[0]) + steady[1], args)
    return {"args": (args, t0, start, np.linalg.qr(first)[0]), "end": end, "first": first, "last": last @ carried}


def _lifted(t, y, args) -> tuple[np.ndarray, np.ndarray]:
    """x (3,) of y, and its derivative (3, 2)."""
    right = args["C"] @ y + args["e"] * np.cos(args["omega"] * t)
    roots = np.roots([args["kappa"], 0, 1, -right]) if args["kappa"] else np.array([right])
    z = float(np.real(roots[np.argmin(np.abs(np.imag(roots)))]))
    for _ in range(3):  # of the roots by eigenvalues to rounding
        z -= (z + args["kappa"] * z**3 - right) / (1 + 3 * args["kappa"] * z**2)
    slope = args["C"] / (1 + 3 * args["kappa"] * z**2)
    q = rotation(np.float64(t), args, np)
    return q @ np.append(y, z), q @ np.vstack([np.eye(2), slope])


@functools.partial(jax.jit, static_argnums=0)
def _motions(name: str, batch):
    def one(given):
        args, t0, x0, frame = given
        where = {"t0": t0, "t1": LENGTH, "method": METHODS[name], "throw": False}
        s = lh.lyapunov_spectrum(SYSTEM, x0, args, frame=frame, blocks=2, **where)
        m = lh.tangent_map(SYSTEM, x0, args, **where)
        return s.exponents * LENGTH, s.status_code, m.matrix, m.x

    return jax.lax.map(one, batch)


def failures(seeds) -> dict[int, str]:
    """What is wrong, by seed."""
    found, cases = {}, {seed: case(seed) for seed in seeds}
    for name in METHODS:
        for seed, known, (growth, status, matrix, x) in in_batches(functools.partial(_motions, name), cases):
            frame = known["args"][3]
            image = known["last"] @ np.linalg.lstsq(known["first"], frame, rcond=None)[0]
            wanted = np.sort(np.log(np.abs(np.diag(np.linalg.qr(image)[1]))))[::-1]
            size, tangents = 1 + np.max(np.abs(known["end"])), np.linalg.norm(known["last"])
            wrong = judged(
                seed,
                status=status == lh.STATUS.ok,
                end=np.max(np.abs(x - known["end"])) < WITHIN * size,
                matrix=np.linalg.norm(matrix @ known["first"] - known["last"]) < WITHIN * (1 + tangents),
                growth=np.allclose(growth, wanted, rtol=0, atol=WITHIN * np.linalg.cond(image)),
            )
            found |= {one: f"{name}, {what}" for one, what in wrong.items()}
    return found
