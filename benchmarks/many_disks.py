"""Any number of hard disks in C: how `c/many_disks.c` is called, and its checks against what is known.

Our side can start from the same state: `lattice_start` makes one, `run_many_disks` takes any.
"""

import ctypes
import importlib

import numpy as np

from benchmarks import problems, references
from benchmarks.references import Check, Result

FOREVER = 2**62  # collisions


def lattice_start(n: int, density: float = 0.7, aspect: float = 3**0.5 / 2, seed: int = 0):
    """Disks on a triangular lattice with random momenta of sum zero, kinetic energy n.

    Returns:
        The state (4n,), (q_0x, q_0y, …, p_0x, p_0y, …), and the box (2,), L_x/L_y = aspect.
    """
    half = round((n / 4) ** 0.5)
    if n != 4 * half**2:
        raise ValueError(f"n = {n} is not 4 m²: hand in a start and a box of your own.")
    box = np.sqrt(n / density * np.array([aspect, 1 / aspect]))
    column, row = np.divmod(np.arange(n), 2 * half)
    sites = (np.stack([column, row + column % 2 / 2], axis=1) + 0.25) / (2 * half) * box
    momenta = np.random.default_rng(seed).normal(size=(n, 2))
    momenta -= momenta.mean(axis=0)
    momenta *= np.sqrt(2 * n / np.sum(momenta**2))
    return np.concatenate([sites.ravel(), momenta.ravel()]), box


def _lapack(name: str) -> int:
    """The address of a function of the LAPACK that SciPy brings, which JAX calls on CPUs."""
    capsule = importlib.import_module("scipy.linalg.cython_lapack").__pyx_capi__[name]
    get_name, get_pointer = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    get_name.restype, get_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    get_pointer.restype, get_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return get_pointer(capsule, get_name(capsule))


def run_many_disks(
    n: int,
    every: int,
    t1: float = np.inf,
    collisions: int = FOREVER,
    k: int | None = None,
    frame: np.ndarray | None = None,
    log_size: int = 0,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    lapack: bool = False,
) -> Result:
    """Hard disks until t1 or for so many collisions, whichever is first.

    Args:
        n: number of disks.
        every: orthonormalise after so many collisions and at the end; 0: never.
        t1: the time to stop at.
        collisions: the number of collisions to stop after.
        k: number of columns; None: all of the frame.
        frame: (4n, k), None: the first k columns of the paired one.
        log_size: return times and pairs of so many collisions.
        start: state (4n,) and box (2,); None: `lattice_start`.
        lapack: orthonormalise by LAPACK's QR instead of our block Gram-Schmidt, which is faster.
    """
    if not (np.isfinite(t1) or collisions < FOREVER):
        raise ValueError("a run needs an end: t1 or collisions.")
    x, box = (np.array(part, dtype=float) for part in (start or lattice_start(n)))
    frame = np.array((problems.paired_frame(2 * n) if frame is None else frame)[:, :k], order="C")
    sums, time = np.zeros(frame.shape[1]), np.zeros(1)
    times, pairs = np.zeros(log_size), np.zeros((log_size, 2), dtype=np.int64)
    qr = [_lapack(name) if lapack else None for name in ("dgeqrf", "dorgqr")]
    done = references.library().many_disks(
        *(n, frame.shape[1], t1, collisions, every, box, x, frame, sums, time, log_size, times, pairs, *qr)
    )
    return Result(sums, x, float(time[0]), done, events=done, log=(times[:done], pairs[:done]), frame=frame)


def _brute_force(x: np.ndarray, box: np.ndarray, collisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and pairs of the first collisions: of all pairs and 7 × 7 images at each event."""
    n = x.size // 4
    q, p = (part.reshape(n, 2).copy() for part in np.split(x, 2))
    first, second = np.triu_indices(n, 1)
    images = np.stack(np.meshgrid(*[np.arange(-3, 4)] * 2, indexing="ij"), axis=-1).reshape(-1, 2) * box
    t, times, pairs = 0.0, [], []
    for _ in range(collisions):
        apart, v = q[second] - q[first], p[second] - p[first]
        apart = (apart - box * np.round(apart / box))[:, None] + images
        approach, speed2 = np.sum(apart * v[:, None], axis=-1), np.sum(v**2, axis=-1)[:, None]
        discriminant = approach**2 - speed2 * (np.sum(apart**2, axis=-1) - 1)
        with np.errstate(invalid="ignore"):
            root = (-approach - np.sqrt(discriminant)) / speed2
        root[~((approach < 0) & (discriminant > 0))] = np.inf
        pair, image = np.unravel_index(np.argmin(root), root.shape)
        a, b, dt = first[pair], second[pair], root[pair, image]
        q += dt * p
        t += dt
        normal = apart[pair, image] + dt * v[pair]
        kick = (normal @ v[pair]) * normal
        p[a] += kick
        p[b] -= kick
        times.append(t)
        pairs.append((a, b))
    return np.array(times), np.array(pairs)


def _closest(x: np.ndarray, box: np.ndarray) -> float:
    """The smallest distance of two disks."""
    q = x[: x.size // 2].reshape(-1, 2)
    apart = q[:, None] - q
    return float(np.min(np.hypot(*np.moveaxis(apart - box * np.round(apart / box), -1, 0))[np.triu_indices(len(q), 1)]))


def _check_four() -> list[Check]:
    """Four disks: against 60 digits, against the naive program, against the known spectrum."""
    start, name = (np.array(problems.DISKS_START), np.array(problems.DISKS_BOX)), "many disks, 4"
    short = run_many_disks(4, 10, t1=1.0, frame=np.eye(16), log_size=10, start=start)
    raw = run_many_disks(4, 0, t1=1.0, frame=np.eye(16), start=start)
    long, naive = run_many_disks(4, 10, t1=1e4, log_size=40, start=start), references.run_hard_disks(3.0, log_size=40)
    few = run_many_disks(4, 10, t1=100.0, k=5, start=start)
    all_columns = run_many_disks(4, 10, t1=100.0, start=start)
    return [
        Check(f"{name}: first collision times", short.log[0], np.array(references.FIRST_TIMES), 1e-13),
        Check(f"{name}: first pairs", short.log[1], np.array(references.FIRST_PAIRS), 0),
        Check(f"{name}: growth to 1", short.sums, np.array(references.GROWTH_TO_1), 1e-9),
        Check(f"{name}: tangent map to 1", _growth(raw.frame), np.array(references.GROWTH_TO_1), 1e-9),
        Check(f"{name}: times as the naive program's", long.log[0], naive.log[0], 1e-10),
        Check(f"{name}: pairs as the naive program's", long.log[1], naive.log[1], 0),
        Check(f"{name}: five columns alone", few.sums, all_columns.sums[:5], 1e-9),
        # The standard deviation of a run of this length is 0.01.
        Check(f"{name}: exponents", long.exponents[:5], np.array(references.DISKS_POSITIVE), 0.05),
        *_check_conservation(4, 2000),
    ]


def _growth(columns: np.ndarray) -> np.ndarray:
    return np.log(np.abs(np.diag(np.linalg.qr(columns)[1])))


def _check_events(n: int, start: tuple[np.ndarray, np.ndarray], collisions: int) -> list[Check]:
    """Against all pairs and images at each event."""
    times, pairs = _brute_force(*start, collisions)
    found = run_many_disks(n, 0, collisions=collisions, log_size=collisions, k=1, start=start)
    name = f"many disks, {n} in {start[1][0]:.2f} × {start[1][1]:.2f}"
    return [
        Check(f"{name}: times by brute force", found.log[0], times, 1e-7),
        Check(f"{name}: pairs by brute force", found.log[1], pairs, 0),
    ]


def _check_conservation(n: int, collisions: int) -> list[Check]:
    """Pairing, energy, momentum and distances, the last at many times."""
    every, name = {4: 10}.get(n, 64), f"many disks, {n}"
    state, box = lattice_start(n)
    closest = []
    for _ in range(20):
        state = run_many_disks(n, 0, collisions=collisions // 20, k=1, start=(state, box)).x
        closest.append(_closest(state, box))
    run = run_many_disks(n, every, collisions=collisions)
    return [
        Check(f"{name}: overlap", np.minimum(closest, 1.0), np.array(1.0), 1e-9),
        Check(f"{name}: energy", np.sum(state[2 * n :] ** 2) / 2, np.array(n), 1e-9),
        Check(f"{name}: momentum", state[2 * n :].reshape(n, 2).sum(axis=0), np.zeros(2), 1e-10),
        Check(f"{name}: pairing", run.exponents + run.exponents[::-1], np.zeros(4 * n), 1e-9),
        Check(f"{name}: frame", run.frame.T @ run.frame, np.eye(4 * n), 1e-7),
    ]


def _check_sixteen() -> list[Check]:
    """Sixteen disks: both ways to orthonormalise, all events by brute force."""
    ours, lapack = (run_many_disks(16, 64, collisions=256, lapack=lapack) for lapack in (False, True))
    _, box = lattice_start(16)
    whole, half = run_many_disks(16, 16, t1=1.0), run_many_disks(16, 16, t1=0.5)
    rest = run_many_disks(16, 16, t1=0.5, frame=half.frame, start=(half.x, box))
    return [
        Check("many disks, 16: state in two parts", rest.x, whole.x, 1e-10),
        Check("many disks, 16: growth in two parts", half.sums + rest.sums, whole.sums, 1e-10),
        Check("many disks, 16: growth by LAPACK's QR", ours.sums, lapack.sums, 1e-7),
        *_check_events(16, lattice_start(16), 200),
        *_check_conservation(16, 6400),
    ]


def _check_small_boxes() -> list[Check]:
    """Boxes with sides below two diameters, where the contacts with several images of a disk overlap."""
    first = (np.array([0.3, 0.3, 1.1, 1.2, 0.8, 0.6, -0.8, -0.6]), np.array([1.6, 1.7]))
    second = (np.array([0.3, 0.3, 1.0, 1.9, 0.4, -0.9, -0.4, 0.9]), np.array([1.4, 3.2]))
    return [*_check_events(2, first, 15), *_check_events(2, second, 15)]


def _check_sixty_four() -> list[Check]:
    """Sixty-four disks: the known values, within what a run of t = 68 allows (standard deviations over seeds: 2.4
    collisions per time, 0.06, 0.026 and 0.026)."""
    run = run_many_disks(64, 64, collisions=20_000, start=_settled(64))
    rate, positive = run.events / run.time, run.exponents[:125]
    return [
        Check("many disks, 64: collisions per time", np.array(rate), np.array(295.4), 12.0),
        Check("many disks, 64: largest exponent", positive[0], np.array(5.213), 0.3),
        Check("many disks, 64: smallest positive exponent", positive[-1], np.array(1.592), 0.12),
        Check("many disks, 64: h_KS per disk", positive.sum() / 64, np.array(5.957), 0.12),
        *_check_conservation(64, 2560),
    ]


def _settled(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A start that has forgotten the lattice."""
    state, box = lattice_start(n, seed=seed)
    return run_many_disks(n, 0, collisions=100 * n, k=1, start=(state, box)).x, box


def validate() -> list[Check]:
    """Checks of `many_disks.c` against known values; a second or two."""
    return [*_check_four(), *_check_sixteen(), *_check_small_boxes(), *_check_sixty_four()]
