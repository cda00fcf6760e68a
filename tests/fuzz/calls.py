"""Random sequences of calls on small systems: each answer against that of another call that must give the same.

A run that goes on is one long run, also by way of a file; a sweep is single runs; what is printed, drawn, stored and
compiled by the user's own `jit` is what was computed; a refused call changes nothing. Anything else is a failure.
"""

import functools
import pickle
import re
import tempfile
import warnings
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import lyaphybrid as lh

from . import arguments

BLOCKS, MOST_BLOCKS = 4, 16
WITHIN = 1e-8  # what is the same up to rounding, and to its growth
EVENTS = lh.EventDriven(
    flow=lambda dt, t, x, a: jnp.stack([x[0] - dt, x[1] * jnp.exp(a * dt)]),
    next_event=lambda t, x, a: (x[0], 0),
    jump=lambda t, x, a, which: jnp.stack([x[0] + 1.0, 0.5 * x[1]]),
    guard=lambda t, x, a, which: x[0],
)
SYSTEMS: dict[str, tuple[Any, Any, float, tuple[float, float], Any]] = {  # system, x0 by a number, unit, args, method
    "map": (arguments.HENON, lambda u: [0.1 + 0.1 * u, 0.2], 32, (0.3, 0.9), None),  # its motions are periodic
    "flow": (arguments.DAMPED, lambda u: [0.1, 0.2 + u], 2.0, (0.1, 0.9), None),
    "fixed steps": (arguments.DAMPED, lambda u: [0.1, 0.2 + u], 2.0, (0.1, 0.9), lh.RungeKutta(dt=0.05)),
    "hybrid": (arguments.BALL, lambda u: [0.3 + u, 0.0], 3.1, (0.5, 2.0), None),
    "events": (EVENTS, lambda u: [0.3 + 0.5 * u, 1.0], 3.3, (-0.5, 0.7), None),
    "DAE": (arguments.SAW, lambda u: [0.5 + u, 0.5 + u], 1.0, (0.5, 2.0), None),
    "pendulum": (arguments.PENDULUM, lambda u: [0.5 + u, 0.5], 1.0, (0.5, 1.0), None),
}


class Session:
    """A system, its start and parameters, and the spectrum that the calls so far have led to."""

    def __init__(self, draw: np.random.Generator):
        self.draw, self.name = draw, str(draw.choice(list(SYSTEMS)))
        self.system, start, unit, self.range, self.method = SYSTEMS[self.name]
        self.x0, self.args = np.array(start(draw.uniform())), float(draw.uniform(*self.range))
        self.length, self.blocks = unit, BLOCKS
        self.spectrum = self.run()

    def run(self, args=None, **more) -> lh.Spectrum:
        """One run, as long as the session's spectrum."""
        given: dict[str, Any] = {"t1": self.length, "blocks": self.blocks, "method": self.method} | more
        return lh.lyapunov_spectrum(self.system, self.x0, self.args if args is None else args, **given)

    def off(self, other, of=None) -> bool:
        """Whether exponents, state or time differ from those of the session's spectrum, or of another one."""
        of = self.spectrum if of is None else of
        pairs = [(getattr(other, name), getattr(of, name)) for name in ("exponents", "x", "t", "jumps", "stderr")]
        return other.status is not of.status or not all(np.allclose(a, b, rtol=WITHIN, atol=WITHIN) for a, b in pairs)


def again(session: Session):
    """The same call gives the same numbers, to the last bit."""
    other = session.run()
    same = np.array_equal(other.exponents, session.spectrum.exponents) and np.array_equal(other.x, session.spectrum.x)
    return not same and session.blocks == BLOCKS  # a run that went on has them up to rounding


def longer(session: Session):
    """A run that goes on is one long run; the session has it from now on."""
    if session.blocks == MOST_BLOCKS:
        return False
    session.length, session.blocks = 2 * session.length, 2 * session.blocks
    session.spectrum = session.spectrum.resume(session.length)
    return session.off(session.run())


def by_file(session: Session):
    """A run that goes on from a file, in a new call, is one long run."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.npz"
        session.run(checkpoint=path)
        whole = session.run(checkpoint=path, resume=True)
        more = session.run(checkpoint=path, resume=True, t1=2 * session.length)
    return session.off(whole) or session.off(more, session.run(t1=2 * session.length, blocks=2 * session.blocks))


def path(session: Session):
    """A trajectory ends where the spectrum does, after as many jumps."""
    given = {"t1": session.length, "n": 5, "method": session.method}
    found = lh.trajectory(session.system, session.x0, session.args, **given)
    jumped = 0 if session.name == "map" else int(found.j[-1]) - int(session.spectrum.jumps)
    ends = np.allclose(found.x[-1], session.spectrum.x, rtol=1e-6, atol=1e-6)
    return not (ends and jumped == 0)


def tangents(session: Session):
    """The volume of the tangent map is the sum of the exponents."""
    found = lh.tangent_map(session.system, session.x0, session.args, t1=session.length, method=session.method)
    if session.name == "DAE" or np.linalg.cond(found.matrix) > 1e8:
        return False
    volume = np.linalg.slogdet(found.matrix)[1]
    return abs(volume - session.length * float(np.sum(session.spectrum.exponents))) > 1e-5 * (1 + abs(volume))


def printed(session: Session):
    """Each exponent is printed to the digits that are shown, with the status; as HTML too."""
    text, html = str(session.spectrum), session.spectrum._repr_html_()
    shown = re.findall(r"λ\d+ +(-?\d+(?:\.(\d+))?(?:e-?\d+)?)", text)
    values = np.asarray(session.spectrum.exponents)
    near = [
        abs(float(number) - value) <= 0.51 * 10.0 ** -len(digits)
        for (number, digits), value in zip(shown, values, strict=False)
        if "e" not in number
    ]
    return not (len(shown) == len(values) and all(near) and "status ok" in text and "λ1" in html)


def stored(session: Session):
    """A dataset and a pickled copy hold the same numbers; the copy cannot go on, and says so."""
    data, copy = session.spectrum.to_xarray(), pickle.loads(pickle.dumps(session.spectrum))
    same = np.array_equal(data.exponents, session.spectrum.exponents)
    same = same and np.array_equal(copy.exponents, session.spectrum.exponents) and str(copy) == str(session.spectrum)
    return not same or refusal(lambda: copy.resume(2 * session.length)) != "ValueError"


@functools.cache
def runner(name: str, x0: tuple[float, ...]):
    """A function of args for sweeps, the same object each time, so that it is compiled once."""
    system, _, unit, _, method = SYSTEMS[name]
    return lambda args: lh.lyapunov_spectrum(system, list(x0), args, t1=unit, blocks=BLOCKS, method=method, throw=False)


def swept(session: Session):
    """A sweep, refined at times, is single runs."""
    _, start, unit, _, _ = SYSTEMS[session.name]
    x0 = start(0.5)
    run, values = runner(session.name, tuple(x0)), np.sort(session.draw.uniform(*session.range, 3))
    data = lh.sweep(run, {"args": values}, args=1.0, progress=False)
    dimension = "args"
    if session.draw.random() < 0.3:
        data, dimension = lh.refine(data, run, args=1.0, levels=1, classify=halves, progress=False), "point"
    wrong = data.sizes[dimension] < len(values)
    for i, value in enumerate(data.args.values):
        one = lh.lyapunov_spectrum(
            session.system, x0, float(value), t1=unit, blocks=BLOCKS, method=session.method, throw=False
        )
        point = data.isel({dimension: i})
        wrong = wrong or int(point.status) != one.status
        wrong = wrong or not np.allclose(point.exponents, one.exponents, rtol=WITHIN, atol=WITHIN)
    return wrong


def halves(points):
    """A class of points that changes within each sweep."""
    return points.args.values > np.mean(points.args.values)


@functools.cache
def jitted(name: str):
    system, _, unit, _, method = SYSTEMS[name]
    return jax.jit(
        lambda x0, args: lh.lyapunov_spectrum(system, x0, args, t1=unit, blocks=BLOCKS, method=method).exponents
    )


def under_jit(session: Session):
    """Under `jax.jit` the exponents are the same."""
    unit = SYSTEMS[session.name][2]
    found = jitted(session.name)(session.x0, session.args)
    return not np.allclose(found, session.run(t1=unit, blocks=BLOCKS).exponents, rtol=WITHIN, atol=WITHIN)


def drawn(session: Session):
    """A picture can be drawn, of all kinds that there are."""
    for kind in ("spectrum", "convergence"):
        session.spectrum.plot(kind=kind)
        plt.close("all")
    return False


def checked(session: Session):
    """`lh.check` finds nothing wrong with a right system."""
    return not lh.check(session.system, session.x0, session.args, method=session.method).ok


def periodic(session: Session):
    """A fixed point of the map has the multipliers of the rule's derivative there."""
    if session.name != "map":
        return False
    found = lh.floquet(session.system, session.x0, session.args, period=1, throw=False)
    if found.status is not lh.STATUS.ok:
        return False
    derivative = jax.jacobian(lambda x: session.system.rule(0.0, x, session.args))(found.x0)
    wanted, have = np.linalg.eigvals(np.asarray(derivative)), np.asarray(found.multipliers)
    return not np.allclose(np.sort_complex(wanted), np.sort_complex(have), atol=1e-8)


def refused(session: Session):
    """What cannot be is refused by an error that says so, and changes nothing."""
    calls = {
        "back": lambda: session.spectrum.resume(0.5 * session.length),
        "no length": lambda: session.run(t1=-1.0),
        "no number": lambda: session.run(t1=float("nan")),
        "no state": lambda: session.run(frame=np.ones((5, 5))),
        "no word": lambda: session.run(averaging="both"),
        "no axis": lambda: lh.sweep(lambda args: args, {"rho": [1.0]}, args=1.0, progress=False),
    }
    name = str(session.draw.choice(list(calls)))
    return refusal(calls[name]) != "ValueError" or again(session)


def hostile(session: Session):
    """After a hostile argument, of any verb, calls give what they gave before."""
    said = arguments.verdict(*arguments.case(int(session.draw.integers(10**6))))
    return said or again(session)


def refusal(call) -> str:
    """The name of the error that a call raises; empty if none."""
    try:
        call()
    except (lh.LyaphybridError, ValueError, TypeError) as error:
        return type(error).__name__
    return ""


OFTEN = (again, longer, by_file, path, tangents, printed, stored, swept, under_jit, periodic, refused, hostile)
SELDOM = (drawn, checked)  # which take long


def failures(seeds) -> dict[int, str]:
    """What is wrong, by seed."""
    found = {}
    for seed in seeds:
        draw, done = np.random.default_rng(seed), []
        try:
            with arguments.limited(60.0), warnings.catch_warnings():
                warnings.filterwarnings("ignore", category=UserWarning)  # notes for the reader
                session = Session(draw)
                for _ in range(int(draw.integers(2, 6))):
                    choice = SELDOM if draw.random() < 0.03 else OFTEN
                    call = choice[int(draw.integers(len(choice)))]
                    done.append(call.__name__)
                    said = call(session)
                    if said:
                        found[seed] = f"{session.name}, {', '.join(done)}: {said}"
                        break
        except Exception as error:
            found[seed] = f"{', '.join(done)}: {type(error).__name__}: {str(error)[:300]}"
    return found
