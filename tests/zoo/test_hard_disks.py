"""Hard disks: the 60-digit case, Table I of Dinius with replicates, pairing and zeros."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from references import load_event_driven

DISKS = load_event_driven()["hard_disks"]
TABLE = DISKS["N4_rho0.7_TableI"]


def sixty_digits():
    """The short case of the reference: start, events, checkpoints."""
    case = DISKS["N4_rho0.7_short_time_60digit"]
    problem = lh.zoo.hard_disks()
    return case, problem, jnp.array([float(v) for v in case["ic"]])


def starts(count, seed=0):
    """Independent momenta at the same kinetic energy and total momentum."""
    keys = jax.random.split(jax.random.key(seed), count)
    return jnp.stack([lh.zoo.hard_disks(key=key).x0 for key in keys])


def test_the_same_pairs_at_the_same_times_as_sixty_digits():
    """Thirty collisions; chaos multiplies rounding by e^(4.9 t)."""
    case, problem, x0 = sixty_digits()
    events = lh.trajectory(problem.system, x0, problem.args, t1=2.3, n=1).events
    expected = case["events"][: len(events)]
    assert len(events) >= 30
    which = [int(w) for w in np.asarray(events.which)]
    assert [(w // 4, w % 4) for w in which][:30] == [(k, m) for _, k, m in expected[:30]]
    times = np.array([float(t) for t, _, _ in expected])
    gap = np.abs(np.asarray(events.t) - times)
    assert np.max(gap[times < 1]) < 1e-8
    assert np.max(gap[times < 2]) < 1e-7


def test_the_tangent_map_of_sixty_digits():
    """M(1), fifteen saltation matrices and flights."""
    case, problem, x0 = sixty_digits()
    matrix = lh.tangent_map(problem.system, x0, problem.args, t1=1.0).matrix
    expected = np.array([float(v) for v in case["t=1.0"]["M_row_major"]]).reshape(16, 16)
    assert np.max(np.abs(matrix - expected)) < 1e-9 * np.max(np.abs(expected))


def check_table(spectrum, gate):
    """Within five standard errors, and the standard errors below a gate."""
    positive, stderr = np.asarray(spectrum.exponents[:5]), np.asarray(spectrum.stderr[:5])
    combined = np.hypot(stderr, TABLE["se"])
    assert np.all(stderr < gate)
    assert np.all(np.abs(positive - np.array(TABLE["lambda_positive"])) <= 5 * combined)
    assert np.sum(np.abs(spectrum.exponents) < 0.01) == 6
    assert np.max(np.abs(spectrum.exponents + spectrum.exponents[::-1])) < 1e-9
    assert abs(float(jnp.sum(spectrum.exponents))) < 1e-9


@pytest.mark.slow
def test_table_one_from_sixteen_replicates():
    """t = 1000 each; six zeros, pairing, sum."""
    problem = lh.zoo.hard_disks()
    check_table(lh.lyapunov_spectrum(problem.system, starts(16), problem.args, t1=1000.0, every=10), 0.012)


def test_nine_times_the_energy_is_three_times_the_speed():
    """The same paths: M in units of its own momenta is the same, so exponents scale as √K."""
    slow, fast = (lh.zoo.hard_disks(kinetic_energy=energy) for energy in (4.0, 36.0))
    units = np.repeat([1.0, 3.0], 8)
    np.testing.assert_allclose(fast.x0, units * np.asarray(slow.x0), rtol=1e-14)
    one = lh.tangent_map(slow.system, slow.x0, slow.args, t1=1.5)
    other = lh.tangent_map(fast.system, fast.x0, fast.args, t1=0.5)
    assert one.jumps == other.jumps > 10
    scaled = units[:, None] * np.asarray(one.matrix) / units[None, :]
    np.testing.assert_allclose(other.matrix, scaled, rtol=0, atol=1e-9 * np.max(np.abs(scaled)))
    np.testing.assert_allclose(fast.reference.exponents, 3 * np.array(slow.reference.exponents), rtol=1e-14)


@pytest.mark.slow
def test_exponents_scale_as_the_root_of_the_energy():
    """K = 36, the exponents of the table times three."""
    problem = lh.zoo.hard_disks()
    x0 = starts(16, seed=2) * jnp.repeat(jnp.array([1.0, 3.0]), 8)[None, :]
    spectrum = lh.lyapunov_spectrum(problem.system, x0, problem.args, t1=1000.0, every=10)
    errors = np.hypot(spectrum.stderr[:5] / 3, TABLE["se"])
    assert np.all(errors < 0.008)
    assert np.all(np.abs(spectrum.exponents[:5] / 3 - np.array(TABLE["lambda_positive"])) <= 5 * errors)


@pytest.mark.slow
def test_table_one_to_three_thousandths():
    """A total time of 1.6e5."""
    problem = lh.zoo.hard_disks()
    x0 = starts(32, seed=1)
    spectrum = lh.lyapunov_spectrum(problem.system, x0, problem.args, t1=5000.0, transient=50.0, every=5)
    check_table(spectrum, 0.003)
    rate = float(spectrum.jumps / spectrum.time)
    assert abs(rate - TABLE["collision_rate"]) < 5 * 0.068 / np.sqrt(160)  # 0.068: scatter of runs of t = 1000
