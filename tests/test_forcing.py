"""The part of a field that depends on time alone is computed once for each time, and nothing else changes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid.methods.forcing import at_times, takes_sines

FRACTIONS = (0.5, 1.0)
T, H, X = 0.7, 0.1, np.array([0.3, -0.4])


def forced(t, x, args):
    return jnp.stack([x[1], jnp.cos(args * t) - x[0]])


def twice_forced(t, x, args):
    force = jnp.array([jnp.sin(args * t), 0.5]) * jnp.exp(-t)
    return force * x[0] + jnp.tan(0.1 * t) * x


@jax.jit
def compiled(t, x, args):
    return jnp.stack([x[1], jnp.sinc(args * t) - jnp.sin(x[0])])


def branching(t, x, args):
    return jnp.where(t > 0.75, jnp.sin(args * t), jnp.cos(t)) * x


def only_time(t, x, args):
    return jnp.sin(jnp.array([t, args * t]))


def vain(t, x, args):
    jnp.sin(t)
    return -x


def constant(t, x, args):
    return jnp.array([1.0, 2.0])


def autonomous(t, x, args):
    return jnp.stack([x[1], -jnp.sin(x[0])])


FIELDS = [forced, twice_forced, compiled, branching, only_time, vain, constant, autonomous]


@pytest.mark.parametrize("field", FIELDS, ids=lambda f: getattr(f, "__name__", "compiled"))
def test_the_field_is_the_same(field):
    def both(x, args, h):
        bound = lambda t, x: field(t, x, args)  # noqa: E731
        here = at_times(bound, jnp.asarray(T), x, h, FRACTIONS)
        return jnp.stack([here[c](x) for c in FRACTIONS]), jnp.stack([bound(T + c * h, x) for c in FRACTIONS])

    for run in (both, jax.jit(both)):
        ours, plain = run(jnp.asarray(X), jnp.asarray(2.8), jnp.asarray(H))
        np.testing.assert_allclose(ours, plain, rtol=1e-15, atol=1e-16)
    for derivative in (jax.jacfwd, jax.jacrev):
        ours, plain = derivative(both, argnums=(0, 1, 2))(jnp.asarray(X), jnp.asarray(2.8), jnp.asarray(H))
        for a, b in zip(ours, plain, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-15)
    lanes = jnp.array([0.1, 0.2, 0.3])
    ours, plain = jax.vmap(both, in_axes=(None, None, 0))(jnp.asarray(X), jnp.asarray(2.8), lanes)
    np.testing.assert_allclose(ours, plain, rtol=1e-15, atol=1e-16)


def test_a_step_takes_each_cosine_once():
    """RK4 sees two new times a step: two cosines in one vector, kept from repetition; plainly written it is four."""
    method = lh.RungeKutta("rk4", dt=H)

    def step(x):
        field = lambda t, x: forced(t, x, 2.8)  # noqa: E731
        done = method.step(field, jnp.asarray(T), x, field(T, x), jnp.asarray(H))
        return done.x, done.f

    jaxpr = jax.make_jaxpr(step)(jnp.asarray(X))
    names = [eqn.primitive.name for eqn in jaxpr.eqns]
    assert names.count("cos") == 1, "the one at the start of the step, of the field itself"
    assert names.count("cond") == 1


def conditionals_of_a_stage(field):
    jaxpr = jax.make_jaxpr(lambda x: at_times(field, jnp.asarray(T), x, H, FRACTIONS)[1.0](x))(jnp.asarray(X))
    return [eqn.primitive.name for eqn in jaxpr.eqns].count("cond")


def test_a_field_of_cheap_functions_stays_as_it_is():
    assert conditionals_of_a_stage(lambda t, x: jnp.stack([x[1], -x[0] * x[1]])) == 0


def test_a_stage_takes_each_sine_of_the_state_once():
    """A sine of the state is behind a conditional with the rest of the field; one of time behind another."""
    assert conditionals_of_a_stage(lambda t, x: jnp.stack([x[1], -jnp.sin(x[0])])) == 1
    assert conditionals_of_a_stage(lambda t, x: jnp.stack([x[1], jnp.cos(t) - jnp.sin(x[0])])) == 2


# --- tangents at the points of a trial ------------------------------------------------------------------------------


def pendulum(t, x):
    return jnp.stack([x[1], jnp.cos(t) - jnp.sin(x[0]) * (1 + 0.1 * jnp.cos(2 * t)) - 0.1 * x[1]])


def swung(t, x):
    return jnp.sin(jnp.roll(x, 1) * t) * x - jnp.tan(0.1 * x)


def cubed(t, x):
    return x - x**3


METHODS = [lh.RungeKutta("rk4", dt=H), *(lh.RungeKutta(tableau) for tableau in ("dopri5", "tsit5", "dopri8", "dop853"))]


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.tableau)
@pytest.mark.parametrize(("field", "n"), [(pendulum, 2), (swung, 3), (cubed, 3)])
def test_the_tangent_at_known_points_is_the_derivative_of_the_step(method, field, n):
    t, h, frame = jnp.asarray(T), jnp.asarray(H), jnp.cos(jnp.arange(4.0 * n).reshape(n, 4))

    @jax.jit
    def tangents(x):
        way = method.step(field, t, x, field(t, x), h).way
        assert len(way) == method.way_points
        ways = method.tangent(field, t, x, h, frame, way), method.rare_tangent(field, t, x, h, frame, way)
        found = *ways, method.tangent(field, t, x, h, frame)
        values = [(one.frame, one.errors, method.divergence(field, one.nodes, h)) for one in found]
        return values, found[0].stages[1], found[2].stages[1]

    (*ours, derived), stages, derived_stages = tangents(jnp.linspace(0.3, -0.4, n))
    assert len(stages) == method.kept_stages(n)
    for a, b in zip(stages, derived_stages, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-14)
    for found in ours:
        for a, b in zip(found, derived, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-14)


def test_the_points_on_the_way_depend_on_the_start():
    """Differentiated once more, the tangent at known points is still that of the step."""
    method, t, h = METHODS[0], jnp.asarray(T), jnp.asarray(H)

    def frame(x, known):
        way = method.step(pendulum, t, x, pendulum(t, x), h).way if known else ()
        return method.tangent(pendulum, t, x, h, jnp.eye(2), way).frame

    ours, plain = (jax.jit(jax.jacfwd(frame), static_argnums=1)(jnp.asarray(X), known) for known in (True, False))
    np.testing.assert_allclose(ours, plain, rtol=1e-13, atol=1e-14)
    assert jnp.max(jnp.abs(plain)) > 1e-3


def test_a_tangent_takes_the_sines_of_all_points_at_once():
    """One conditional holds all cosines; a plain derivative asks for each, and for the sines."""
    method = lh.RungeKutta("rk4", dt=H)

    def names(way):
        tangent = lambda x, frame, way: method.tangent(autonomous_pendulum, 0.7, x, H, frame, way).frame  # noqa: E731
        jaxpr = jax.make_jaxpr(tangent)(jnp.asarray(X), jnp.eye(2), way)
        return [eqn.primitive.name for eqn in jaxpr.eqns]

    at_points = names((jnp.asarray(X),) * method.way_points)
    assert at_points.count("cond") == 1
    assert not {"sin", "cos"}.intersection(at_points)
    assert names(()).count("cond") > 1


def autonomous_pendulum(t, x):
    return jnp.stack([x[1], -jnp.sin(x[0])])


def test_sines_of_the_state_are_seen():
    x = jnp.asarray(X)
    assert takes_sines([autonomous_pendulum], T, x)
    assert takes_sines([cubed, pendulum], T, x)
    assert not takes_sines([lambda t, x: forced(t, x, 2.8), cubed], T, x)
