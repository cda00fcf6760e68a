"""What must hold wherever the package runs: one small case of each kind, with its exact value.

`python -m tests.portability` runs this file with each Python and each JAX, with either engine and on two CPU devices.
`LYAPHYBRID_TEST_FLOAT32=1` runs it as a newcomer does, without float64. tests/portability.json is what was found.
"""

import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

XLA = os.environ.get("LYAPHYBRID_ENGINE") == "xla"
FLOAT32 = bool(os.environ.get("LYAPHYBRID_TEST_FLOAT32"))
CLOSE = {"rtol": 1e-3, "atol": 1e-3} if FLOAT32 else {"rtol": 1e-7, "atol": 1e-7}
SWITCHES = ("jax_debug_nans", "jax_debug_infs", "jax_disable_jit")
ARGS = {"rate": 0.25, "kept": 0.5}
EXPONENTS = 0.0, ARGS["rate"] + np.log(ARGS["kept"])  # of all three systems below
TURN = {"t1": 8.0, "blocks": 4}

pytestmark = [
    pytest.mark.filterwarnings("ignore:x0? is float32"),
    pytest.mark.filterwarnings("ignore:.*float64:UserWarning"),
]


@pytest.fixture(autouse=True)
def _precision():
    with jax.enable_x64(not FLOAT32):
        yield


def drift(t, x, args):
    """A phase that runs, and a height that grows at `rate`."""
    return jnp.stack([jnp.ones_like(x[0]), args["rate"] * x[1]])


def kicked():
    """Once a turn the phase starts again, and a part of the height is kept."""
    return lh.Hybrid(
        lambda t, x, args: drift(t, x, args),
        lh.Transition(lambda t, x, args: 1.0 - x[0], lambda t, x, args: jnp.stack([x[0] - 1.0, args["kept"] * x[1]])),
    )


def spread():
    """The same exponents without jumps: what a kick takes is spread over its turn."""
    return lh.Flow(lambda t, x, args: jnp.stack([jnp.ones_like(x[0]), (args["rate"] + jnp.log(args["kept"])) * x[1]]))


KICKED = kicked()
SAMPLED = lh.Hybrid(  # the same by a clock
    drift, lh.Transition(every=1.0, reset=lambda t, x, args: jnp.stack([x[0] - 1.0, args["kept"] * x[1]]))
)
START = np.array([0.25, 1.0])


def spectrum(args, system=KICKED, **keywords):
    start = jnp.asarray(START, jnp.result_type(float))
    return lh.lyapunov_spectrum(system, start, args, **TURN | keywords)


@pytest.fixture(scope="module")
def make():
    """What makes a system whose loop is compiled in several ways.

    XLA takes nine tenths of this file's time to compile loops, and most of that for derivatives and lanes of one that
    looks for events. There this system has no jumps; what XLA makes of jumps is seen by the plain spectra.
    """
    return spread if XLA else kicked


@pytest.fixture(scope="module")
def system(make):
    return make()


def test_a_flow_that_jumps():
    found = spectrum(ARGS)
    assert_allclose(sorted(found.exponents), sorted(EXPONENTS), **CLOSE)
    assert int(found.jumps) == 8
    assert str(found.status).startswith("ok")


def test_fixed_steps():
    found = spectrum(ARGS, method=lh.RungeKutta("rk4", dt=0.01))
    assert_allclose(sorted(found.exponents), sorted(EXPONENTS), **CLOSE)


def test_a_clock():
    assert_allclose(sorted(spectrum(ARGS, SAMPLED).exponents), sorted(EXPONENTS), **CLOSE)


def test_a_map():
    logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
    found = lh.lyapunov_spectrum(logistic, jnp.array([0.3]), 2.9, transient=500, t1=100)
    assert_allclose(found.exponents, np.log(0.9), **CLOSE)


def test_a_hamiltonian():
    """Exponents of a saddle, ±1, and of a rotation, 0 and 0, in the first coordinates of each pair."""
    saddle = lh.Hamiltonian(lambda p, args: jnp.sum(p * p) / 2, lambda q, args: (4 * q[1] * q[1] - q[0] * q[0]) / 2)
    start = jnp.array([0.0, 0.5, 0.0, 0.0])
    found = lh.lyapunov_spectrum(saddle, start, t1=16.0, transient=16.0)
    first, *_, last = found.exponents
    assert_allclose([first, last], [1.0, -1.0], rtol=1e-3)
    assert_allclose(found.exponents + found.exponents[::-1], 0, atol=1e-3 if FLOAT32 else 1e-9)


@pytest.mark.slow
def test_a_dae():
    """x' = -x/2, 0 = y - 2x."""
    dae = lh.DAE(
        lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
        lambda t, x, args: jnp.stack([-0.5 * x[0], x[1] - 2 * x[0]]),
        n_differential=1,
    )
    if FLOAT32:
        with pytest.raises(ValueError, match=r"an lh\.DAE needs float64"):
            lh.lyapunov_spectrum(dae, jnp.array([1.0, 2.0]), t1=8.0)
        return
    found = lh.lyapunov_spectrum(dae, jnp.array([1.0, 2.0]), t1=8.0)
    assert_allclose(found.exponents, [-0.5], **CLOSE)


@pytest.mark.slow
def test_an_implicit_method():
    found = spectrum(ARGS, method=lh.ESDIRK())
    assert_allclose(sorted(found.exponents), sorted(EXPONENTS), rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_lanes(system):
    rates = jnp.array([0.1, 0.2, 0.3])
    found = jax.vmap(lambda rate: spectrum(ARGS | {"rate": rate}, system).exponents[1])(rates)
    assert_allclose(found, np.minimum(rates + np.log(0.5), 0), **CLOSE)


@pytest.mark.slow
def test_shard_map_that_checks_what_varies_is_refused_and_spoils_nothing(system):
    mesh, spec = jax.sharding.Mesh(np.array(jax.devices()), ("lanes",)), jax.sharding.PartitionSpec("lanes")
    lanes = jax.vmap(lambda rate: spectrum(ARGS | {"rate": rate}, system).exponents[1])
    checked = jax.shard_map(lanes, mesh=mesh, in_specs=spec, out_specs=spec)
    with pytest.raises(ValueError, match=r"check_vma=False.*'lanes'"):
        checked(jnp.array([0.1, 0.2] * len(jax.devices())))
    assert_allclose(spectrum(ARGS, system).exponents, EXPONENTS, **CLOSE)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["placed", "shard_map"])
def test_lanes_divided_between_devices(how, system):
    """All devices that there are, one or several."""
    mesh, spec = jax.sharding.Mesh(np.array(jax.devices()), ("lanes",)), jax.sharding.PartitionSpec("lanes")
    lanes = jax.vmap(lambda rate: spectrum(ARGS | {"rate": rate}, system).exponents[1])
    rates = jax.device_put(jnp.linspace(0.1, 0.4, 4), jax.sharding.NamedSharding(mesh, spec))
    if how == "shard_map":
        lanes = jax.shard_map(lanes, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
    found = jax.jit(lanes)(rates)
    assert found.sharding.device_set == set(jax.devices())
    assert_allclose(found, np.asarray(rates) + np.log(0.5), **CLOSE)


@pytest.mark.slow
def test_under_jit():
    assert_allclose(jax.jit(lambda args: spectrum(args).exponents[1])(ARGS), EXPONENTS[1], **CLOSE)


@pytest.mark.slow
@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.grad], ids=["forward", "reverse"])
def test_derivatives(derivative, system):
    """d/d rate = 1, d/d kept = 1/kept."""

    def wanted(args):
        return spectrum(args, system, method=lh.RungeKutta("rk4", dt=0.05), t1=4.0).exponents[1]

    found = derivative(wanted)({name: jnp.asarray(value) for name, value in ARGS.items()})
    assert_allclose(found["rate"], 1.0, rtol=1e-3)
    assert_allclose(found["kept"], 2.0, rtol=1e-3)


@pytest.mark.slow
def test_a_sweep(system):
    kept = np.array([0.4, 0.5, 0.6])
    found = lh.sweep(lambda args: spectrum(args, system), {"kept": kept}, args=ARGS, progress=False)
    assert_allclose(found.exponents[:, 1], ARGS["rate"] + np.log(kept), **CLOSE)


def test_a_trajectory():
    found = lh.trajectory(KICKED, jnp.asarray(START), ARGS, t1=2.0)
    assert_allclose(found.x[-1], [0.25, np.exp(0.5) * 0.25], **CLOSE)


@pytest.mark.slow_cases("jax_debug_nans")
@pytest.mark.parametrize("switch", SWITCHES)
def test_debugging_switches_change_nothing(switch, make, system):
    """Runs mark by nan what was not computed, and loop without end without jit: so they ignore these switches.

    The system is a new one, so that its functions are traced, compiled and run under the switch.
    """
    before = getattr(jax.config, switch)
    jax.config.update(switch, True)
    try:
        found = spectrum(ARGS, make())
        exponents = np.asarray(found.exponents)
    finally:
        jax.config.update(switch, before)
    assert np.array_equal(exponents, spectrum(ARGS, system).exponents)


@pytest.mark.skipif(not FLOAT32, reason="of float32")
def test_float32_is_warned_of():
    with pytest.warns(UserWarning, match="float32"):
        spectrum(ARGS, t1=4.0)


@pytest.mark.parametrize("read", [lambda x: x[2], lambda x: x[jnp.array([0, 2])], lambda x: x.at[2].set(0.0)])
def test_an_entry_beyond_the_end_is_refused(read):
    """Of JAX's versions each keeps constants in another way."""
    with pytest.raises(ValueError, match="entry 2"):
        lh.lyapunov_spectrum(lh.Flow(lambda t, x, args: read(x) * jnp.ones_like(x)), START, t1=1.0)
