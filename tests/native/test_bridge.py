"""Native code within JAX: the same numbers in jit, vmap, jvp and all their nestings, and by XLA where it must be."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

from lyaphybrid import native
from lyaphybrid.native.bridge import programs as _programs


def lorenz(rho, x):
    return jnp.stack([10 * (x[1] - x[0]), x[0] * (rho - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]])


def orbit(rho, steps=100, dt=0.01):
    """The end of an orbit: a loop with a floating-point and an integer state."""

    def step(state):
        i, x = state
        middle = x + dt / 2 * lorenz(rho, x)
        return i + 1, x + dt * lorenz(rho, middle)

    return jax.lax.while_loop(lambda state: state[0] < steps, step, (jnp.int32(0), jnp.ones(3)))[1]


def around(function):
    """A user's function around it."""
    return lambda rho: jnp.sum(jnp.sin(function(rho)) * rho)


OURS, XLAS = around(native.native(orbit)), around(orbit)
RHO, RHOS = jnp.float64(28.0), jnp.linspace(27.0, 29.0, 5)
NESTINGS = {
    "eager": (lambda f: f, RHO),
    "jit": (jax.jit, RHO),
    "vmap": (jax.vmap, RHOS),
    "jit of vmap": (lambda f: jax.jit(jax.vmap(f)), RHOS),
    "vmap of jit": (lambda f: jax.vmap(jax.jit(f)), RHOS),
    "vmap of vmap": (lambda f: jax.vmap(jax.vmap(f)), RHOS.reshape(5, 1) + jnp.arange(2.0).reshape(1, 2)),
    "vmap over the last axis": (lambda f: jax.vmap(jax.vmap(f, in_axes=-1), in_axes=-1), RHOS.reshape(1, 5)),
    "jacfwd": (jax.jacfwd, RHO),
    "jit of jacfwd": (lambda f: jax.jit(jax.jacfwd(f)), RHO),
    "vmap of jacfwd": (lambda f: jax.vmap(jax.jacfwd(f)), RHOS),
    "jacfwd of vmap": (lambda f: jax.jacfwd(jax.vmap(f)), RHOS),
    "second derivative": (lambda f: jax.jacfwd(jax.jacfwd(f)), RHO),
    "loop": (lambda f: lambda x: jax.lax.fori_loop(0, 3, lambda i, y: 27 + 0.01 * f(y), x), RHO),
    "branch": (lambda f: lambda x: jax.lax.cond(x > 0, f, lambda y: y, x), RHO),
    "checkpoint": (lambda f: jax.jacfwd(jax.checkpoint(f)), RHO),
}


@pytest.mark.slow_cases("jacfwd of vmap")
@pytest.mark.parametrize("nesting", NESTINGS)
def test_every_nesting_gives_what_xla_gives(nesting):
    transform, operand = NESTINGS[nesting]
    np.testing.assert_allclose(transform(OURS)(operand), transform(XLAS)(operand), rtol=1e-10)


def smooth(rho, x):
    """A function that has reverse derivatives as it is."""
    for _ in range(5):
        x = x + 0.1 * lorenz(rho, x)
    return jnp.sin(x)


PAIR = jnp.float64(1.2), jnp.array([0.3, 0.2, 0.1])
REVERSE = {
    "grad": lambda f: jax.grad(lambda rho, x: jnp.sum(f(rho, x))),
    "jacrev": lambda f: jax.jacrev(f, argnums=(0, 1)),
    "jit of jacrev": lambda f: jax.jit(jax.jacrev(f, argnums=1)),
    "vmap of grad": lambda f: (
        lambda rho, x: jax.vmap(jax.grad(lambda x: jnp.sum(f(rho, x) ** 2)))(x[None, :] + jnp.eye(3))
    ),
    "grad of vmap": lambda f: jax.grad(lambda rho, x: jnp.sum(jax.vmap(lambda r: f(r, x))(rho * jnp.arange(3.0)) ** 2)),
    "hessian": lambda f: jax.hessian(lambda rho, x: jnp.sum(f(rho, x) ** 2), argnums=1),
    "reverse over reverse": lambda f: jax.jacrev(jax.jacrev(lambda rho, x: jnp.sum(f(rho, x) ** 2)), argnums=1),
}


@pytest.mark.slow_cases(all_but=("grad",))
@pytest.mark.parametrize("nesting", REVERSE)
def test_reverse_derivatives(nesting):
    ours, theirs = (REVERSE[nesting](function)(*PAIR) for function in (native.native(smooth), smooth))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-12), ours, theirs)


def test_the_reverse_pass_may_be_another_program():
    """A loop of which nobody knows how long it is has none of its own."""
    shape = jax.ShapeDtypeStruct((), jnp.float64)
    closed = jax.make_jaxpr(lambda rho: jnp.sum(orbit(rho, 20)))(shape)

    def in_scan(rho):
        step = lambda x, _: (x + 0.01 * lorenz(rho, x + 0.005 * lorenz(rho, x)), None)  # noqa: E731
        return [jnp.sum(jax.lax.scan(step, jnp.ones(3), length=20)[0])]

    def function(program):
        return lambda rho: native.native_call.bind(rho, program=program)[0]

    expected = jax.grad(lambda rho: in_scan(rho)[0])(RHO)
    assert abs(expected) > 1e-3
    np.testing.assert_allclose(jax.grad(function(native.Program(closed, backward=in_scan)))(RHO), expected, rtol=1e-12)
    with pytest.raises(ValueError, match="[Rr]everse-mode"):
        jax.grad(function(native.Program(closed)))(RHO)


def test_a_program_within_another_is_part_of_it():
    outer = native.native(lambda rhos: jax.lax.map(lambda rho: OURS(rho) + 1, rhos))
    text = native.compile(lambda rhos: jax.lax.map(OURS, rhos), RHOS).compiled.text
    assert text.count("define") == 2  # the program, and what XLA calls
    np.testing.assert_allclose(outer(RHOS), jax.vmap(XLAS)(RHOS) + 1, rtol=1e-10)


def test_shard_map_over_devices():
    mesh = jax.sharding.Mesh(np.array(jax.devices()), ("lanes",))
    spec = jax.sharding.PartitionSpec("lanes")
    rhos = jnp.linspace(27.0, 29.0, 2 * jax.device_count())

    def mapped(function):
        return jax.jit(jax.shard_map(jax.vmap(function), mesh=mesh, in_specs=spec, out_specs=spec))

    np.testing.assert_allclose(mapped(OURS)(rhos), jax.vmap(XLAS)(rhos), rtol=1e-10)


def test_export_takes_xlas_code():
    exported = export.export(jax.jit(OURS))(RHO)
    assert "@lyaphybrid_native" not in exported.mlir_module()
    np.testing.assert_allclose(exported.call(RHO), XLAS(RHO), rtol=1e-10)


def test_pytrees_types_and_shapes_are_kept():
    @native.native
    def function(tree, n):
        return {"sum": tree["a"] + n, "none": None, "pair": (tree["b"] > 0, jnp.zeros((0, 2), jnp.float32))}

    found = function({"a": np.arange(3), "b": jnp.array([1.0, -1.0])}, 2)
    assert set(found) == {"sum", "none", "pair"}
    np.testing.assert_array_equal(found["sum"], [2, 3, 4])
    np.testing.assert_array_equal(found["pair"][0], [True, False])
    assert (found["pair"][1].shape, found["pair"][1].dtype) == ((0, 2), jnp.float32)
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(found))


def test_a_program_is_traced_once_for_each_shape_and_type():
    traces = []

    @native.native
    def function(x):
        traces.append(x.shape)
        return 2 * x

    for argument in (1.0, np.float64(2.0), jnp.float64(3.0), jnp.asarray(4.0)):  # weakly typed or not
        function(argument)
    jax.jit(function)(5.0)
    assert traces == [()]
    function(jnp.ones(2))
    assert traces == [(), (2,)]


def test_derived_programs_are_made_once():
    traces = []

    @native.native
    def function(x):
        return jnp.sin(x)

    made = _programs.Program._made

    def counted(self, key, *rest):
        if key not in self._derived:
            traces.append(key[0])
        return made(self, key, *rest)

    for _ in range(3):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_programs.Program, "_made", counted)
            jax.jvp(function, (1.0,), (1.0,))
            jax.vmap(function)(RHOS)
    assert traces == ["pushed", "mapped"]


def test_a_reverse_derivative_does_not_trace_the_tangents():
    program = native.Program(jax.make_jaxpr(smooth)(*PAIR))

    def total(rho):
        return jnp.sum(native.native_call.bind(rho, PAIR[1], program=program)[0])

    jax.grad(total)(PAIR[0])
    (tangents,) = [made for made in program._derived.values() if made.origin]
    assert "closed" not in vars(tangents)
    jax.jvp(total, PAIR[:1], PAIR[:1])
    assert "closed" in vars(tangents)


def test_other_threads_run_during_a_call():
    long = native.native(lambda n: jax.lax.fori_loop(0, n, lambda i, x: jnp.cos(x), 0.5))
    long(10)
    finished, turns = threading.Event(), 0

    def call():
        long(10_000_000)
        finished.set()

    thread = threading.Thread(target=call)
    thread.start()
    while not finished.wait(1e-3):
        turns += 1
    thread.join()
    assert turns > 3  # this thread was not held up


@pytest.fixture
def unsupported():
    """A function with a primitive that has no rule."""
    return lambda x: jax.scipy.special.digamma(x) + 1


def test_what_the_compiler_does_not_take_goes_to_xla_and_is_noted_once(unsupported, monkeypatch, caplog):
    monkeypatch.setenv("LYAPHYBRID_ENGINE", "auto")
    monkeypatch.setattr(_programs, "_noted", set())
    first, second = native.native(unsupported), native.native(lambda x: unsupported(2 * x))
    np.testing.assert_allclose(first(2.0), unsupported(2.0))
    np.testing.assert_allclose(second(2.0), unsupported(4.0))
    np.testing.assert_allclose(jax.jit(first)(2.0), unsupported(2.0))
    np.testing.assert_allclose(jax.jacfwd(first)(2.0), jax.jacfwd(unsupported)(2.0))
    notes = [record.getMessage() for record in caplog.records if "digamma" in record.getMessage()]
    assert notes == ["compiled by XLA, not natively: the primitive digamma has no rule."]


def test_where_native_code_is_demanded_it_is_an_error(unsupported, monkeypatch):
    monkeypatch.setenv("LYAPHYBRID_ENGINE", "native")
    with pytest.raises(native.UnsupportedError, match="the primitive digamma"):
        native.native(unsupported)(2.0)


def test_the_engine_is_chosen_by_a_variable(monkeypatch):
    function = native.native(lambda x: 3 * x)
    monkeypatch.setenv("LYAPHYBRID_ENGINE", "XLA")
    monkeypatch.setattr("lyaphybrid.native.bridge.programs.Compiled", None)  # must not be used
    assert float(function(2.0)) == 6
    monkeypatch.setenv("LYAPHYBRID_ENGINE", "fortran")
    with pytest.raises(ValueError, match="must be one of auto, native, xla; got 'fortran'"):
        native.engine()


def test_results_that_nobody_differentiates_do_not_spoil_the_others():
    """The derivative of a root at zero is infinite: times a cotangent of zero it would be nan."""

    def both(x):
        return jnp.sum(x * x), jnp.sqrt(jnp.sum(x))

    call = native.native(both)
    x = jnp.zeros(3)
    np.testing.assert_array_equal(jax.grad(lambda x: call(x)[0])(x), np.zeros(3))
    np.testing.assert_array_equal(jax.jacrev(lambda x: call(x + 1.0)[0])(x), np.full(3, 2.0))


@pytest.mark.parametrize("bits", [32, 64])
def test_arrays_are_placed_as_jax_places_them(bits):
    arrays = [np.arange(6.0).reshape(2, 3), np.array(1.5), np.arange(3), np.array([True, False]), np.zeros((0, 2))]
    arrays = [*arrays, np.float64(2.0), jnp.ones(2), np.arange(8.0)[::2], np.ones(3, np.float32), jax.random.key(1)]
    with jax.enable_x64(bits == 64):
        for ours, theirs in zip(native.on_device(arrays), jax.device_put(arrays), strict=True):
            assert ours.aval == theirs.aval
            assert ours.committed == theirs.committed
            assert ours.sharding == theirs.sharding
            assert jnp.array_equal(ours, theirs)
