"""The C references: compiled at first use, called through ctypes, checked against known values by `validate`.

Each ``run_…`` function starts from the problem's start and returns a `Result`; nothing is kept between calls.
"""

import ctypes
import functools
import os
import pathlib
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks import problems

SOURCES = pathlib.Path(__file__).parent / "c"
# sqrt of a negative number is never taken here; having to set errno for it would keep loops from vectorising:
# without -fno-math-errno the hard disks take 2.7 times as long, Lorenz every ten steps 1.4 times.
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC")

_Array = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
_Counts = np.ctypeslib.ndpointer(dtype=np.int64, flags="C_CONTIGUOUS")
_SIGNATURES = {
    "lorenz": [ctypes.c_int64] * 2 + [ctypes.c_double] + [_Array] * 4,
    "henon_heiles": [ctypes.c_int64] * 2 + [ctypes.c_double] + [_Array] * 3,
    "impact_fixed": [ctypes.c_double] * 2 + [_Array] * 5 + [_Counts],
    "impact_adaptive": [ctypes.c_double] * 4 + [_Array] * 5 + [_Counts],
    "friction_fixed": [ctypes.c_double] * 2 + [_Array] * 5 + [_Counts],
    "friction_adaptive": [ctypes.c_double] * 4 + [_Array] * 5 + [_Counts],
    "hard_disks": [ctypes.c_double, ctypes.c_int64] + [_Array] * 4 + [ctypes.c_int64, _Array, _Counts],
    "spring_damper_discrete": [ctypes.c_double] * 2 + [_Array] * 4 + [_Counts],
    "spring_damper_continuous": [ctypes.c_double] * 2 + [_Array] * 4 + [_Counts],
    "spring_damper_sweep": [ctypes.c_int64] + [ctypes.c_double] * 2 + [_Array] * 3 + [_Counts],
    "klein_gordon": [ctypes.c_int64] * 4
    + [ctypes.c_double, ctypes.c_int64, _Array, _Array]
    + [ctypes.c_double] * 2
    + [_Array] * 3,
    "schroedinger": [ctypes.c_int64] * 4
    + [ctypes.c_double, ctypes.c_int64, _Counts, _Array, _Array, ctypes.c_double]
    + [_Array] * 3,
    "many_disks": [ctypes.c_int64] * 2
    + [ctypes.c_double]
    + [ctypes.c_int64] * 2
    + [_Array] * 5
    + [ctypes.c_int64, _Array, _Counts]
    + [ctypes.c_void_p] * 2,
}


class NoCompilerError(RuntimeError):
    """There is no C compiler: our times can be measured, ratios cannot."""


class Result(NamedTuple):
    """What one run of a reference returns."""

    sums: np.ndarray  # (k,) Σ ln R_ii; of a sweep (lanes, k)
    x: np.ndarray  # (n,) at the end; empty for a sweep
    time: float
    steps: int  # steps taken, or collisions
    events: int = 0
    rejected: int = 0
    losses: int = 0  # friction: of the second column
    log: tuple = ()  # hard disks: times (m,) and pairs (m, 2) of the first collisions
    frame: np.ndarray = np.empty((0, 0))  # many disks (4n, k), spring (4, 2): at the end

    @property
    def exponents(self) -> np.ndarray:
        """Exponents (k,) per unit time, in the order of the columns."""
        return self.sums / self.time


def compiler() -> str:
    """The C compiler: $CC, or cc.

    Raises:
        NoCompilerError: if there is none.
    """
    found = shutil.which(os.environ.get("CC", "cc"))
    if found is None:
        raise NoCompilerError(
            "no C compiler was found (cc, or what the environment variable CC names): there is nothing to"
            " compare with, and only our own times are reported."
        )
    return found


def build(target: str, flags: tuple[str, ...] = FLAGS) -> None:
    """Compile the references into the shared library `target`."""
    sources = sorted(str(path) for path in SOURCES.glob("*.c"))
    done = subprocess.run([compiler(), *flags, *sources, "-o", target, "-lm"], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"the C references do not compile:\n{done.stderr}")


@functools.cache
def library() -> ctypes.CDLL:
    """The references, compiled for this processor into a folder that is gone once they are loaded."""
    with tempfile.TemporaryDirectory() as folder:
        target = os.path.join(folder, "references.so")
        build(target)
        loaded = ctypes.CDLL(target)
    for name, arguments in _SIGNATURES.items():
        function = getattr(loaded, name)
        function.argtypes = arguments
        function.restype = ctypes.c_int64
    return loaded


def run_lorenz(
    t1: float, every: int, dt: float = problems.LORENZ_DT, parameters: Sequence[float] = problems.LORENZ_PARAMETERS
) -> Result:
    """Lorenz63 by RK4, with all three columns."""
    x, frame, sums = np.array(problems.LORENZ_START), np.eye(3), np.zeros(3)
    parameters = np.array(parameters)
    steps = library().lorenz(round(t1 / dt), every, dt, parameters, x, frame, sums)
    return Result(sums, x, steps * dt, steps)


def run_henon_heiles(
    t1: float, every: int, dt: float = problems.HENON_HEILES_DT, start: Sequence[float] = problems.HENON_HEILES_START
) -> Result:
    """Hénon and Heiles' system by SBAB2 with its corrector, with the tangent map of all four columns."""
    x, frame, sums = np.array(start), np.ascontiguousarray(problems.paired_frame(2)), np.zeros(4)
    steps = library().henon_heiles(round(t1 / dt), every, dt, x, frame, sums)
    return Result(sums, x, steps * dt, steps, frame=frame)


def run_impact(
    t1: float, adaptive: bool, dt: float = problems.IMPACT_DT, args: dict[str, float] = problems.IMPACT_PARAMETERS
) -> Result:
    """The impact oscillator: RK4 at dt, or Dormand–Prince 5(4) with dt as the first step."""
    x, tolerances = np.array(problems.IMPACT_START), (problems.IMPACT_RTOL, problems.IMPACT_ATOL)
    parameters = np.array([args[name] for name in ("zeta", "omega", "restitution")])
    return _run_planar("impact", t1, dt, tolerances if adaptive else (), parameters, np.zeros(1), x, np.eye(2))


def run_friction(
    t1: float,
    adaptive: bool,
    dt: float = problems.FRICTION_DT,
    args: dict[str, float] = problems.FRICTION_PARAMETERS,
    transient: float = 0.0,
) -> Result:
    """The pendulum with dry friction: RK4 at dt, or Dormand–Prince 5(4) with dt as the first step."""
    x, tolerances = np.array(problems.FRICTION_START), (problems.FRICTION_RTOL, problems.FRICTION_ATOL)
    parameters = np.array([args[name] for name in ("beta", "alpha", "stiffness", "amplitude", "omega")])
    start = dt, tolerances if adaptive else (), parameters, np.zeros(1), x, np.eye(2)
    _run_planar("friction", transient, *start)
    return _run_planar("friction", t1, *start)


def _run_planar(name: str, t1: float, dt: float, tolerances, parameters, time, x, frame) -> Result:
    """What includes planar.h: goes on from time, x and frame, which move."""
    run = getattr(library(), f"{name}_adaptive" if tolerances else f"{name}_fixed")
    sums, counts, begin = np.zeros(2), np.zeros(3, dtype=np.int64), float(time[0])
    steps = run(t1, dt, *tolerances, parameters, time, x, frame, sums, counts)
    events, losses, rejected = counts.tolist()
    return Result(sums, x, float(time[0]) - begin, steps, events, rejected, losses)


def run_hard_disks(t1: float, frame: np.ndarray | None = None, log_size: int = 0) -> Result:
    """Four hard disks, with all sixteen columns; `frame` (16, 16) defaults to the paired one."""
    x, sums = np.array(problems.DISKS_START), np.zeros(16)
    frame = np.array(problems.paired_frame(8) if frame is None else frame)
    times, pairs = np.zeros(log_size), np.zeros((log_size, 2), dtype=np.int64)
    every, box = problems.DISKS_EVERY, np.array(problems.DISKS_BOX)
    collisions = library().hard_disks(t1, every, box, x, frame, sums, log_size, times, pairs)
    return Result(sums, x, t1, collisions, events=collisions, log=(times, pairs))


def run_spring_damper(t1: float, continuous: bool, tol: float = problems.SPRING_TOL) -> Result:
    """The DAE of the spring with a damper, by the discrete or the continuous QR method; growth after the first QR."""
    run = library().spring_damper_continuous if continuous else library().spring_damper_discrete
    columns, triangle = np.linalg.qr(np.array(problems.SPRING_COLUMNS))
    frame = np.ascontiguousarray(columns * np.sign(np.diagonal(triangle)))
    x, sums, counts = np.array(problems.SPRING_START), np.zeros(2), np.zeros(1, dtype=np.int64)
    parameters = np.array(list(problems.SPRING_PARAMETERS.values()))
    steps = run(t1, tol, parameters, x, frame, sums, counts)
    return Result(sums, x, t1, steps, rejected=int(counts[0]), frame=frame)


def run_spring_damper_sweep(lanes: int, t1: float = problems.SPRING_SWEEP_T1) -> Result:
    """The same by the discrete method, for `lanes` values of the damping one after the other."""
    parameters = np.tile(list(problems.SPRING_PARAMETERS.values()), (lanes, 1))
    parameters[:, list(problems.SPRING_PARAMETERS).index("damping")] = np.linspace(*problems.SPRING_DAMPINGS, lanes)
    sums, counts, start = np.zeros((lanes, 2)), np.zeros(1, dtype=np.int64), np.array(problems.SPRING_START[:2])
    steps = library().spring_damper_sweep(lanes, t1, problems.SPRING_TOL, parameters, start, sums, counts)
    return Result(sums, np.empty(0), t1, steps, rejected=int(counts[0]))


def run_swept(run: Callable[[float], Result], values: Sequence[float]) -> Result:
    """Lanes, one after the other on one thread: the mean of their sums and times, and all their steps and events."""
    lanes = [run(value) for value in values]
    return Result(
        np.mean([lane.sums for lane in lanes], axis=0),
        np.empty(0),
        float(np.mean([lane.time for lane in lanes])),
        sum(lane.steps for lane in lanes),
        sum(lane.events for lane in lanes),
    )


class Check(NamedTuple):
    """A number of a reference against what is known about it."""

    name: str
    values: np.ndarray
    expected: np.ndarray
    tolerance: float

    @property
    def passed(self) -> bool:
        """Whether every value is within the tolerance."""
        return bool(np.all(np.abs(np.asarray(self.values) - self.expected) <= self.tolerance))


def _check_lorenz(every: int) -> list[Check]:
    exponents = run_lorenz(4e4, every).exponents
    divergence = -(10 + 1 + 8 / 3)
    return [
        Check(f"lorenz, every {every}: exponents", exponents, np.array([0.9059, 0.0, -14.5725]), 0.01),
        Check(f"lorenz, every {every}: sum", exponents.sum(), np.array(divergence), 5e-4),  # RK4 leaves 1e-4
    ]


def _check_henon_heiles() -> list[Check]:
    run = run_henon_heiles(2e5, every=10)
    x, y, px, py = run.x
    energy = (px * px + py * py + x * x + y * y) / 2 + x * x * y - y**3 / 3
    return [
        Check("Hénon and Heiles: energy", np.array(energy), np.array(0.125), 1e-7),
        Check("Hénon and Heiles: pairs", run.exponents + run.exponents[::-1], np.zeros(4), 1e-12),
        # The standard deviation of a run of this length is 2e-3.
        Check("Hénon and Heiles: exponents", run.exponents, np.array([0.04434, 0.0, 0.0, -0.04434]), 0.01),
    ]


def _check_impact(adaptive: bool) -> list[Check]:
    run = run_impact(1e5, adaptive)
    name = "impact, adaptive" if adaptive else "impact, fixed"
    zeta, restitution = problems.IMPACT_PARAMETERS["zeta"], problems.IMPACT_PARAMETERS["restitution"]
    sum_rule = -2 * zeta + 2 * np.log(restitution) * run.events / run.time
    return [
        Check(f"{name}: exponents", run.exponents, np.array([0.15766, -0.47592]), 0.01),
        Check(f"{name}: sum rule", run.exponents.sum(), np.array(sum_rule), 1e-8),
    ]


def _check_impact_methods() -> list[Check]:
    fixed, adaptive = run_impact(30.0, adaptive=False, dt=0.001), run_impact(30.0, adaptive=True)
    return [
        Check("impact, two methods: state at 30", fixed.x, adaptive.x, 1e-5),
        Check("impact, two methods: growth to 30", fixed.sums, adaptive.sums, 1e-5),
    ]


# The pendulum with dry friction: a periodic orbit that slips always (two exponents of this value), one that sticks
# twice a period, and chaos that sticks once in 2700 periods (of its second exponent, what is finite).
FRICTION_SLIPS, FRICTION_STICKS = -0.152604511216, -0.028474432538
FRICTION_CHAOS, FRICTION_CROSSINGS = (0.12031, -0.17727), 1.6422


def _check_friction(adaptive: bool) -> list[Check]:
    name, period = "friction, adaptive" if adaptive else "friction, fixed", problems.FRICTION_PERIOD
    known = problems.FRICTION_PARAMETERS
    slips = run_friction(200 * period, adaptive, args=known | {"beta": 0.3}, transient=200 * period)
    sticks = run_friction(200 * period, adaptive, args=known | {"alpha": 0.5}, transient=200 * period)
    periods = 5_000
    chaos = run_friction(periods * period, adaptive)
    crossings = (chaos.events - 2 * chaos.losses) / periods
    return [
        Check(f"{name}: exponents of an orbit that slips", slips.exponents.mean(), np.array(FRICTION_SLIPS), 1e-8),
        Check(f"{name}: exponent of an orbit that sticks", sticks.exponents[0], np.array(FRICTION_STICKS), 1e-7),
        Check(f"{name}: losses of an orbit that sticks", np.array(sticks.losses), np.array(400), 1),
        # The standard deviations of a run of this length are 3e-3 and 0.015.
        Check(f"{name}: exponents in chaos", chaos.exponents, np.array(FRICTION_CHAOS), 0.012),
        Check(f"{name}: crossings in chaos", np.array(crossings), np.array(FRICTION_CROSSINGS), 0.06),
    ]


def _check_friction_methods() -> list[Check]:
    fixed, adaptive = run_friction(60.0, adaptive=False, dt=0.002), run_friction(60.0, adaptive=True)
    return [
        Check("friction, two methods: state at 60", fixed.x, adaptive.x, 1e-5),
        Check("friction, two methods: growth to 60", fixed.sums, adaptive.sums, 1e-5),
    ]


# Collisions and the tangent map to 60 digits (mpmath, event by event): ln R_ii of the tangent map over one
# time unit, from the columns e_1 … e_16.
FIRST_TIMES = (
    *(0.094546778655600907763, 0.13515294243252095216, 0.20491825007574360327, 0.29322262940852650161),
    *(0.33181681041478999581, 0.37752687442417581174, 0.49745279476951014507, 0.60425429003847874033),
    *(0.69729993041774298841, 0.77805834514671427261),
)
FIRST_PAIRS = ((0, 2), (1, 3), (0, 1), (1, 3), (0, 2), (1, 2), (1, 2), (1, 2), (0, 1), (2, 3))
GROWTH_TO_1 = (
    *(4.187355042836, 4.592081178211, 3.135435700382, 2.941587785004),
    *(0.7526395040939, 1.586110901968, 0.6344774675339, 0.5324156025306),
    *(-0.3148290882603, -0.6473142215733, -0.6030518783066, -1.324248637349),
    *(-2.830556304074, -4.014463914409, -3.793412449721, -4.834226688866),
)
DISKS_POSITIVE = (4.8824, 4.1314, 3.5469, 3.0547, 2.6269)


def _check_hard_disks() -> list[Check]:
    short, long = run_hard_disks(1.0, np.eye(16), log_size=10), run_hard_disks(1000.0)
    times, pairs = short.log
    expected = np.array([*DISKS_POSITIVE, *[0.0] * 6, *(-np.array(DISKS_POSITIVE[::-1]))])
    return [
        Check("hard disks: first collision times", times, np.array(FIRST_TIMES), 1e-13),
        Check("hard disks: first pairs", pairs, np.array(FIRST_PAIRS), 0),
        Check("hard disks: growth to 1", short.sums, np.array(GROWTH_TO_1), 1e-9),
        # The standard deviation of a run of this length is 0.03.
        Check("hard disks: exponents", long.exponents, expected, 0.15),
    ]


# The growth of orthonormalised columns over the paper's two times, to all digits; and the steps that Table 1 has for
# the discrete method over the first of them.
SPRING_EXPONENTS = ((-0.17982701889600464, -2.8206929901660955), (-0.17739461191053466, -2.822657388995675))
SPRING_STEPS = 10_890


def _check_spring_damper(continuous: bool) -> list[Check]:
    name = "spring, continuous" if continuous else "spring, discrete"
    runs = [run_spring_damper(t1, continuous) for t1 in problems.SPRING_T1]
    checks = [
        Check(f"{name}: exponents at {run.time:g}", run.exponents, np.array(known), 1e-5)
        for run, known in zip(runs, SPRING_EXPONENTS, strict=True)
    ]
    fine = run_spring_damper(problems.SPRING_T1[0], continuous, tol=1e-10)
    checks.append(Check(f"{name}: exponents, fine", fine.exponents, np.array(SPRING_EXPONENTS[0]), 1e-9))
    checks.append(Check(f"{name}: orthonormal columns", fine.frame.T @ fine.frame, np.eye(2), 1e-14))
    if not continuous:
        checks.append(Check(f"{name}: steps", np.array(runs[0].steps), np.array(SPRING_STEPS), 0.03 * SPRING_STEPS))
    return checks


def _check_spring_damper_sweep() -> list[Check]:
    sweep, alone = run_spring_damper_sweep(3), run_spring_damper(problems.SPRING_SWEEP_T1, continuous=False)
    return [Check("spring, sweep: the middle lane", sweep.exponents[1], alone.exponents, 1e-12)]


def validate() -> list[Check]:
    """Checks of every reference against known values; a few seconds."""
    return [
        *_check_lorenz(every=1),
        *_check_lorenz(every=10),
        *_check_henon_heiles(),
        *_check_impact(adaptive=False),
        *_check_impact(adaptive=True),
        *_check_impact_methods(),
        *_check_friction(adaptive=False),
        *_check_friction(adaptive=True),
        *_check_friction_methods(),
        *_check_hard_disks(),
        *_check_spring_damper(continuous=False),
        *_check_spring_damper(continuous=True),
        *_check_spring_damper_sweep(),
    ]
