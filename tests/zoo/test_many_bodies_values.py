"""Many bodies: spectra against event-driven C, memory, sizes.

Pairs are closed to 1e-9 where frames are orthonormalised often enough: the rounding of the smallest exponents is
multiplied by what the largest have stretched meanwhile, e^20 now and then where `every` is left to the growth.
"""

import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from references import load_event_driven

DISKS = load_event_driven()["hard_disks"]
SIXTY_FOUR = DISKS["N64_rho0.7"]
LOW_DENSITY = tuple(
    [*five, *[0.0] * 6, *(sign * value for value in reversed(five))]
    for five, sign in ((DISKS["N4_rho0.2"]["lambda_positive"], -1), (DISKS["N4_rho0.2"]["se"], 1))
)  # all sixteen, and their standard errors
RATE_SCATTER = SIXTY_FOUR["collision_rate_se"] * SIXTY_FOUR["total_time"] ** 0.5  # of a run, times √t


def starts(count, seed=0, **parameters):
    """Of independent momenta, (count, 4n)."""
    keys = jax.random.split(jax.random.key(seed), count)
    return jnp.stack([lh.zoo.hard_disks(key=key, **parameters).x0 for key in keys])


def agree(found, stderr, reference, reference_stderr, gate):
    """Within five combined standard errors, ours below a gate."""
    found, stderr = np.asarray(found), np.asarray(stderr)
    assert np.all((0 < stderr) & (stderr < gate)), stderr
    deviations = (found - reference) / np.hypot(stderr, reference_stderr)
    assert np.all(np.abs(deviations) <= 5), deviations


def check_low_density(spectrum, entropies, gate):
    """All sixteen, five positive, their negatives, six zeros; entropies (m,) a disk, independent ones."""
    reference, errors = (np.array(a) for a in LOW_DENSITY)
    exponents, moving = np.asarray(spectrum.exponents), reference != 0
    assert np.sum(moving) == 10
    agree(exponents[moving], spectrum.stderr[moving], reference[moving], errors[moving], gate)
    assert np.sum(np.abs(exponents) < 0.01) == 6
    assert np.max(np.abs(exponents + exponents[::-1])) < 1e-9
    stderr, known = np.std(entropies, ddof=1) / len(entropies) ** 0.5, DISKS["N4_rho0.2"]
    agree(np.mean(entropies), stderr, known["hKS_per_particle"], known["hKS_per_particle_se"], gate)


def entropies(spectrum, n, positive):
    """Of each block, a body."""
    durations = np.diff(np.asarray(spectrum.history.time), prepend=0.0)
    return np.sum(np.asarray(spectrum.history.growth)[:, :positive], axis=1) / durations / n


@pytest.mark.slow
def test_four_disks_at_a_low_density():
    spectrum = lh.zoo.hard_disks(n=4, density=0.2).spectrum(t1=10_000.0, transient=50.0, every=4)
    check_low_density(spectrum, entropies(spectrum, 4, 5), 0.02)


@pytest.mark.slow
def test_four_disks_at_a_low_density_from_many_starts():
    problem, x0 = lh.zoo.hard_disks(n=4, density=0.2), starts(32, seed=1, n=4, density=0.2)
    spectrum = problem.spectrum(x0=x0, t1=4000.0, transient=50.0, every=4)
    check_low_density(spectrum, np.sum(np.asarray(spectrum.replicates)[:, :5], axis=1) / 4, 0.004)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("t1", "seed", "gate"),
    [
        (150.0, 0, 0.07),
        pytest.param(600.0, 1, 0.035, marks=pytest.mark.slow),
        pytest.param(2400.0, 2, 0.0175, marks=pytest.mark.slow),
    ],
)
def test_sixty_four_disks(t1, seed, gate):
    """The largest, the smallest positive one, the entropy, the rate of collisions; all 256 in pairs."""
    problem = lh.zoo.hard_disks(n=64, key=jax.random.key(seed))
    spectrum = problem.spectrum(t1=t1, transient=10.0, every=128)
    exponents = np.asarray(spectrum.exponents)
    assert exponents.shape == (256,)
    assert np.max(np.abs(exponents + exponents[::-1])) < 1e-9
    assert np.sum(np.abs(exponents) < 0.01) == 6
    values, errors = np.array(SIXTY_FOUR["lambda_positive"]), np.array(SIXTY_FOUR["se"])
    assert len(values) == 125
    # λ₁ of such runs scatters by 0.64/√t, and 64 blocks tell that to 9 %.
    agree(exponents[:125], spectrum.stderr[:125], values, errors, gate)
    found = entropies(spectrum, 64, 125)
    stderr = np.std(found, ddof=1) / len(found) ** 0.5
    agree(np.mean(found), stderr, SIXTY_FOUR["hKS_per_particle"], SIXTY_FOUR["hKS_per_particle_se"], gate)
    rate = float(spectrum.jumps / spectrum.time)
    agree(rate, RATE_SCATTER / t1**0.5, SIXTY_FOUR["collision_rate"], SIXTY_FOUR["collision_rate_se"], 1.7)


# VmHWM belongs to this program alone; ru_maxrss also counts what the process was before: a fork of pytest.
PEAKS = """
def peak():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1000

import lyaphybrid as lh
from lyaphybrid.native.machine.tiers import Tiers
peaks = [peak()]
# The best code at once: when a thread makes it depends on how busy the machine is.
Tiers._within = lambda self, patience: self._best
import jax
jax.config.update("jax_enable_x64", True)
problem = lh.zoo.hard_disks(n=64)
for t1 in (2.0, 100.0):
    assert len(problem.spectrum(t1=t1, transient=1.0).exponents) == 256
    peaks.append(peak())
print(*peaks)
"""


@pytest.fixture(scope="module")
def peaks():
    """Peak resident memory, MB: after the import, after a short run of 64 disks, after a long one."""
    if not Path("/proc/self/status").exists():
        pytest.skip("no /proc")
    run = subprocess.run([sys.executable, "-c", PEAKS], capture_output=True, text=True, check=True, timeout=300)
    return [float(value) for value in run.stdout.split()]


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length(peaks):
    _, short, long = peaks
    assert long - short < 20


@pytest.mark.slow
def test_memory_above_the_import(peaks):
    assert peaks[-1] - peaks[0] <= 200  # of which LLVM takes 70, once; by XLA 351


@pytest.mark.slow
def test_a_thousand_disks():
    """Sixteen columns of 4096: the largest exponents are those of 64 disks, and some (λ₁ grows with n like ln n/n)."""
    problem = lh.zoo.hard_disks(n=1024)
    spectrum = problem.spectrum(t1=2.0, transient=2.0, k=16)
    exponents = np.asarray(spectrum.exponents)
    assert exponents.shape == (16,)
    assert np.all((exponents > SIXTY_FOUR["lambda_positive"][15] - 0.2) & (exponents < 7))
    per_body = float(spectrum.jumps / spectrum.time) / 1024
    assert abs(per_body / (SIXTY_FOUR["collision_rate"] / 64) - 1) < 0.05


@pytest.mark.slow
def test_eight_spheres():
    """Exactly eight zeros from a generic frame, and pairs from the paired one; both have the same values."""
    problem = lh.zoo.hard_spheres(n=8)
    paired = problem.spectrum(t1=300.0, every=16)
    exponents = np.asarray(paired.exponents)
    assert np.max(np.abs(exponents + exponents[::-1])) < 1e-9
    assert np.sum(np.abs(exponents) < 1e-9) == 8
    frame = np.linalg.qr(np.random.default_rng(3).normal(size=(48, 48)))[0]
    generic = problem.spectrum(t1=300.0, frame=frame, every=16)
    assert np.sum(np.abs(generic.exponents) < 0.05) == 8
    assert exponents[19] > 0.3
    agree(generic.exponents[:20], generic.stderr[:20], exponents[:20], paired.stderr[:20], 0.05)
