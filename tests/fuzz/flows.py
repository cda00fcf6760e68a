"""Random automata (`tests/automata.py`) whose flows are polynomials, oscillations or exponentials in closed form.

Each of two modes has a flow of its own kind and two guards, c·x + d + a sin(ωt + φ), which fire in one direction or in
both; a reset is affine. The truth is a simulation by the closed forms: roots of the guards between samples much
closer than the guards turn, and the derivative of the end by the start from saltation matrices written by hand. A run
ends before whatever would be a matter of rounding: an extremum near zero, two events close to each other, a slow one, a
reset that ends near a guard or beyond it.
"""

import numpy as np
import scipy.linalg
import scipy.optimize

import automata as shapes
import lyaphybrid as lh

from .batches import SIZE, judged

N, MODES, GUARDS = 3, 2, 2
LONGEST, MOST_EVENTS = 6.0, 8
SAMPLES = 400  # of a guard over the time that is left
CLEAR = 0.02  # of a guard, of its rate, of the time between events: what is less is no case
BEFORE = 0.05  # so long before it the run ends
TIMES, STATES, MATRICES = 1e-9, 1e-8, 1e-7  # times the amplification of errors
KINDS = ("polynomial", "oscillating", "exponential")


def flow_matrix(draw: np.random.Generator, kind: str) -> np.ndarray:
    """A (3, 3) of x' = Ax + b."""
    basis = np.linalg.qr(draw.normal(size=(N, N)))[0] @ np.diag(draw.uniform(0.7, 1.4, N))
    if kind == "polynomial":
        middle = np.triu(draw.uniform(-1, 1, (N, N)), 1)
    elif kind == "oscillating":
        rate, omega = draw.uniform(-0.2, 0.1), draw.uniform(0.5, 4)
        middle = np.array([[rate, -omega, 0], [omega, rate, 0], [0, 0, -draw.uniform(0.1, 1)]])
    else:
        middle = np.diag(draw.uniform(-1.0, 0.5, N))
    return basis @ middle @ np.linalg.inv(basis)


def random_arguments(draw: np.random.Generator) -> dict[str, np.ndarray]:
    """The arrays of `automata.automaton`; the guards are positive around the origin."""
    kinds = draw.choice(KINDS, MODES)
    normal = draw.normal(size=(MODES, GUARDS, N))
    return {
        "A": np.stack([flow_matrix(draw, kind) for kind in kinds]), "b": draw.uniform(-1, 1, (MODES, N)),
        "mask": np.ones((MODES, GUARDS), bool), "c": normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        "d": draw.uniform(0.6, 1.5, (MODES, GUARDS)), "a": draw.uniform(0, 0.4, (MODES, GUARDS)),
        "w": draw.uniform(0.3, 3, (MODES, GUARDS)), "p": draw.uniform(0, 6, (MODES, GUARDS)),
        "dir": draw.choice([-1.0, -1.0, 0.0], (MODES, GUARDS)),
        "R": draw.uniform(-0.5, 0.5, (MODES, GUARDS, N, N)), "r": draw.uniform(-0.2, 0.2, (MODES, GUARDS, N)),
        "s": draw.uniform(-0.1, 0.1, (MODES, GUARDS, N)), "u": draw.uniform(0.3, 3, (MODES, GUARDS)),
        "tgt": draw.integers(0, MODES, (MODES, GUARDS)).astype(np.int32),
    }  # fmt: skip


class Motion:
    """The closed form of x' = Ax + b from x0: with eigenvectors, or as a polynomial where A³ = 0."""

    def __init__(self, a, b, x0):
        self.a, self.b, self.x0 = a, b, x0
        self.nilpotent = np.max(np.abs(a @ a @ a)) < 1e-12
        if not self.nilpotent:
            self.rest = -np.linalg.solve(a, b)
            self.rates, self.vectors = np.linalg.eig(a)
            self.parts = np.linalg.solve(self.vectors, (x0 - self.rest).astype(complex))

    def __call__(self, s) -> np.ndarray:
        """(…, 3) the state after the times s."""
        s = np.asarray(s)[..., None]
        if self.nilpotent:
            first = self.a @ self.x0 + self.b
            return self.x0 + s * first + s**2 / 2 * (self.a @ first) + s**3 / 6 * (self.a @ (self.a @ first))
        return self.rest + np.real((np.exp(self.rates * s) * self.parts) @ self.vectors.T)


def guards(args, mode, t, x) -> np.ndarray:
    """(…, guards) at times (…) and states (…, 3)."""
    of_state = x @ args["c"][mode].T + args["d"][mode]
    return of_state + args["a"][mode] * np.sin(args["w"][mode] * np.asarray(t)[..., None] + args["p"][mode])


def simulate(args: dict, mode: int, x, t0: float) -> dict:
    """The events and the derivative of the end by the start, in closed form, until what is a matter of rounding."""
    t, matrix, amplification = t0, np.eye(N), 1.0
    end, events = t0 + LONGEST, []
    while True:
        motion = Motion(args["A"][mode], args["b"][mode], x)
        s, which, until = _next_event(args, mode, motion, t, end - t)
        if which is None or len(events) == MOST_EVENTS:
            stop = min(end, t + until) if which is None else t + s - BEFORE
            break
        carried = scipy.linalg.expm(args["A"][mode] * s)
        before, when = motion(s), t + s
        rate = _rate(args, mode, which, when, before)
        to, after, saltation = _jump(args, mode, which, when, before, rate)
        if np.min(guards(args, to, when, after)) < CLEAR or abs(rate) < 5 * CLEAR:
            stop = when - BEFORE
            break
        events.append((when, mode, which, to))
        matrix, t, mode, x = saltation @ carried @ matrix, when, to, after
        grown = np.linalg.norm(carried, 2), np.linalg.norm(saltation, 2), 1 / abs(rate)
        amplification *= np.prod([max(1.0, size) for size in grown])
    if stop <= t + 1e-3:  # nothing is left after the last event: the run ends there, a little later
        return {"T": None}
    last = scipy.linalg.expm(args["A"][mode] * (stop - t))
    size = amplification * max(1.0, np.linalg.norm(last, 2))
    return {"T": stop, "x": motion(stop - t), "mode": mode, "matrix": last @ matrix, "events": events, "size": size}


def _next_event(args, mode, motion, t, rest):
    """The time to the next event and its guard; or None, and how far the run is clear of any doubt."""
    s = np.linspace(0, rest, SAMPLES)
    values = guards(args, mode, t + s, motion(s))
    changes = values[:-1] * values[1:] < 0
    # A local extremum towards zero that is not far from it: the run ends before it.
    size = np.abs(values)
    low = (size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:]) & (size[1:-1] < CLEAR) & ~(changes[:-1] | changes[1:])
    doubts = np.flatnonzero(low.any(axis=1))
    doubt = s[doubts[0]] - BEFORE if len(doubts) else rest
    doubt = min(doubt, rest if size[-1].min() > CLEAR else rest - BEFORE)
    steps, which = np.nonzero(changes)
    if not len(steps) or s[steps[0]] > doubt:
        return None, None, doubt
    roots = sorted((_root(args, mode, motion, t, s[i], s[i + 1], j), int(j)) for i, j in zip(steps, which, strict=True))
    if len(roots) > 1 and roots[1][0] - roots[0][0] < CLEAR and roots[1][1] != roots[0][1]:
        return None, None, roots[0][0] - BEFORE
    falls = guards(args, mode, t, motion.x0)[roots[0][1]] > 0
    assert falls, "guards are positive after each reset"
    return *roots[0], doubt


def _root(args, mode, motion, t, low, high, j) -> float:
    return scipy.optimize.brentq(lambda s: guards(args, mode, t + s, motion(s))[j], low, high, xtol=1e-14, rtol=1e-14)


def _rate(args, mode, j, t, x) -> float:
    field = args["A"][mode] @ x + args["b"][mode]
    w = args["w"][mode][j]
    return args["c"][mode][j] @ field + args["a"][mode][j] * w * np.cos(w * t + args["p"][mode][j])


def _jump(args, mode, j, t, x, rate):
    """The mode and the state after a reset, and its saltation matrix Dg + (f⁺ − Dg f⁻ − ∂ₜg) ∇h/ḣ."""
    to, u = int(args["tgt"][mode][j]), args["u"][mode][j]
    reset = args["R"][mode][j]
    after = reset @ x + args["r"][mode][j] + args["s"][mode][j] * np.cos(u * t)
    before_field = args["A"][mode] @ x + args["b"][mode]
    after_field = args["A"][to] @ after + args["b"][to]
    moving = -u * args["s"][mode][j] * np.sin(u * t)
    return to, after, reset + np.outer(after_field - reset @ before_field - moving, args["c"][mode][j]) / rate


def case(seed: int) -> dict:
    """An automaton, its start and what is known of it."""
    draw = np.random.default_rng(seed)
    while True:
        args, mode, t0 = random_arguments(draw), int(draw.integers(MODES)), float(draw.uniform(-2, 2))
        x0 = draw.uniform(-0.3, 0.3, N)
        if np.min(guards(args, mode, t0, x0)) < CLEAR:
            continue
        known = simulate(args, mode, x0, t0)
        if known["T"] is not None and known["T"] > t0 + 0.1:
            return known | {"args": args, "x0": x0, "mode0": mode, "t0": t0}


def failures(seeds) -> dict[int, str]:
    """What is wrong, by seed."""
    found, seeds = {}, list(seeds)
    system = shapes.automaton(MODES, GUARDS)
    for begin in range(0, len(seeds), SIZE):
        some = seeds[begin : begin + SIZE]
        cases = [case(seed) for seed in some]
        paths, maps = shapes.motions_of(system, cases + [cases[0]] * (SIZE - len(cases)))
        for i, (seed, known) in enumerate(zip(some, cases, strict=True)):
            found |= _compared(seed, known, paths[i], maps[i])
    return found


def _compared(seed: int, known: dict, path, tangent) -> dict[int, str]:
    count, log, size = len(known["events"]), path.events, known["size"]
    when, before, which, after = (np.array([event[k] for event in known["events"]]) for k in range(4))
    same = path.status_code == tangent.status_code[0] == lh.STATUS.ok and path.j[-1] == count
    same = same and path.mode[-1] == known["mode"]
    for ours, exact in ((log.mode_before, before), (log.which, which), (log.mode_after, after)):
        same = same and np.array_equal(ours[:count], exact)
    if not same:
        return judged(seed, order=False)
    scale = 1 + np.max(np.abs(known["x"]))
    return judged(
        seed,
        times=np.all(np.abs(log.t[:count] - when) < TIMES * size),
        state=np.max(np.abs(path.x[-1] - known["x"])) < STATES * size * scale,
        matrix=np.max(np.abs(tangent.matrix[0] - known["matrix"]))
        < MATRICES * size * max(1.0, np.max(np.abs(known["matrix"]))),
    )
