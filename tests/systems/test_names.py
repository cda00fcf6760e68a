"""Names and units of the components of a state."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import pyplot

import balls
import lyaphybrid as lh
from lyaphybrid._jax.engines import compilations

NAMES, UNITS = ("x", "v"), ("m", "m/s")
CALLED = {"names": NAMES, "units": UNITS}


def swing(t, x, args):
    return jnp.stack([x[1], -x[0]])


def bounce(t, x, args):
    return jnp.stack([x[0], -x[1]])


def height(t, x, args):
    return x[0]


def flown(dt, t, x, args):
    return jnp.stack([x[0] + dt * x[1] - dt**2 / 2, x[1] - dt])


def landing(t, x, args):
    return x[1] + jnp.sqrt(x[1] ** 2 + 2 * x[0]), 0


KINDS = {
    "Flow": lambda **called: lh.Flow(swing, **called),
    "Map": lambda **called: lh.Map(swing, **called),
    "Hybrid": lambda **called: lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1]), lh.Transition(height, bounce), **called
    ),
    "EventDriven": lambda **called: lh.EventDriven(
        flown, landing, lambda t, x, args, which: jnp.stack([0 * x[0], -x[1]]), lambda t, x, args, which: x[0], **called
    ),
    "Hamiltonian": lambda **called: lh.Hamiltonian(
        lambda p, args: jnp.sum(p**2) / 2, lambda q, args: jnp.sum(q**2) / 2, **called
    ),
    "canonical_flow": lambda **called: lh.canonical_flow(lambda q, p, args: jnp.sum(p**2 + q**2) / 2, **called),
    "DAE": lambda **called: lh.DAE(
        lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
        lambda t, x, args: jnp.stack([-x[1], x[1] - 2 * x[0]]),
        1,
        **called,
    ),
    "filippov": lambda **called: lh.filippov(
        lambda t, x, args: jnp.stack([x[1], -x[0] - 1]),
        lambda t, x, args: jnp.stack([x[1], -x[0] + 1]),
        lambda t, x, args: x[1],
        **called,
    ),
}


@pytest.mark.slow_cases("filippov")
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_system_names_its_state_in_datasets_tables_and_axes(kind):
    found = lh.trajectory(KINDS[kind](**CALLED), [1.0, 2.0], t1=2, n=2)
    data = found.to_xarray()
    assert data.state.values.tolist() == list(NAMES)
    assert data.unit.values.tolist() == list(UNITS)
    assert "\n  v " in str(found)
    assert [ax.get_ylabel() for ax in found.plot().figure.axes] == ["x (m)", "v (m/s)"]
    together = found.plot(pyplot.subplots()[1])
    assert [text.get_text() for text in together.get_legend().get_texts()][-2:] == ["x (m)", "v (m/s)"]
    pyplot.close("all")


def test_without_names_components_are_numbered():
    found = lh.trajectory(lh.Flow(swing), [1.0, 2.0], t1=2.0, n=2)
    assert found.to_xarray().state.values.tolist() == ["x0", "x1"]
    assert "unit" not in found.to_xarray().coords


def test_names_compile_nothing():
    """Neither in memory, where programs are kept by the structure of their arguments, nor on disk."""
    plain = lh.Flow(swing)
    before = lh.lyapunov_spectrum(plain, [1.0, 2.0], t1=5.0)
    count = compilations()
    named = eqx.tree_at(lambda flow: flow.field, lh.Flow(swing, **CALLED), plain.field)
    after = lh.lyapunov_spectrum(named, [1.0, 2.0], t1=5.0)
    assert compilations() == count
    np.testing.assert_array_equal(after.exponents, before.exponents)
    assert after.to_xarray().state.values.tolist() == list(NAMES)


def test_of_many_bodies_columns_are_named():
    found = lh.trajectory(balls.between_walls(**CALLED), balls.START, t1=0.75, n=1)
    assert found.to_xarray().x.dims == ("sample", "body", "state")
    assert found.to_xarray().state.values.tolist() == list(NAMES)
    assert "\n  v[1] " in str(found)
    with pytest.raises(ValueError, match="d = 2 columns of the state, which has one row a body; got 1"):
        lh.trajectory(balls.between_walls(names=("x",)), found.x[-1], t1=1.0)


def test_sections_and_return_maps_keep_the_names():
    ball = KINDS["Hybrid"](**CALLED)
    section = lh.poincare_section(ball, [1.0, 0.0], section=lambda t, x, args: x[1], n=2)
    assert section.to_xarray().state.values.tolist() == list(NAMES)
    assert lh.return_map(ball).names == NAMES
    assert lh.return_map(ball, with_time=True).names == (*NAMES, "t")


@pytest.mark.parametrize(
    ("called", "said"),
    [
        (
            {"names": ("x",)},
            r"names must have one entry for each of the n = 2 components of the state; got 1: \('x',\)",
        ),
        ({"names": ("x", "v", "w")}, r"n = 2 components of the state; got 3"),
        ({"units": ("m",)}, r"units must have one entry for each of the n = 2"),
    ],
)
def test_a_wrong_number_of_names_is_said_once_the_state_is_known(called, said):
    system = lh.Flow(swing, **called)
    for verb in (lh.lyapunov_spectrum, lh.trajectory, lh.floquet, lh.gali):
        with pytest.raises(ValueError, match=said):
            verb(system, [1.0, 2.0], **({} if verb is lh.floquet else {"t1": 1.0}))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("called", "said"),
    [
        ({"names": "xv"}, "names must be a sequence of strings"),
        ({"names": (1, 2)}, "names must be a sequence of strings"),
        ({"names": ("x", "x")}, "names must be different from each other"),
        ({"names": ("x", "")}, "names must not be empty"),
        ({"names": ("x", "v"), "units": ("m",)}, "There must be as many units as names, 2; got 1"),
    ],
)
def test_names_that_are_none_are_refused(kind, called, said):
    with pytest.raises(ValueError, match=said):
        KINDS[kind](**called)
