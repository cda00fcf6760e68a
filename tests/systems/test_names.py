"""Names and units of the components of a state, and the unit of time."""

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


@pytest.mark.slow_cases("filippov", "Hybrid", "DAE")
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


def test_without_names_components_are_numbered():
    found = lh.trajectory(lh.Flow(swing), [1.0, 2.0], t1=2.0, n=2)
    assert found.to_xarray().state.values.tolist() == ["x0", "x1"]
    assert "unit" not in found.to_xarray().coords


@pytest.mark.slow
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


@pytest.mark.slow
def test_of_many_bodies_columns_are_named():
    found = lh.trajectory(balls.between_walls(**CALLED), balls.START, t1=0.75, n=1)
    assert found.to_xarray().x.dims == ("sample", "body", "state")
    assert found.to_xarray().state.values.tolist() == list(NAMES)
    assert "\n  v[1] " in str(found)
    with pytest.raises(ValueError, match="d = 2 columns of the state, which has one row a body; got 1"):
        lh.trajectory(balls.between_walls(names=("x",)), found.x[-1], t1=1.0)


def test_events_print_as_a_table():
    bouncing = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1]),
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
        names=("height", "speed"),
    )
    title, heads, first, *more = str(lh.trajectory(bouncing, [0.5, 0.0], t1=4.0, n=2).events).splitlines()
    assert (title, len(more)) == ("2 events", 1)
    events = heads.split()
    assert events == (
        ["t", "transition", "which", "mode_before", "mode_after"]
        + ["height_before", "speed_before", "height_after", "speed_after"]
    )
    assert [float(dict(zip(events, first.split(), strict=True))[name]) for name in ("t", "speed_after")] == [1, 1]
    assert str(lh.trajectory(bouncing, [0.5, 0.0], t1=0.5, n=2).events) == "0 events"
    disks = lh.zoo.hard_disks(n=4)
    many = lh.trajectory(disks.system, disks.x0, disks.args, t1=0.2, n=1).events
    assert str(many).endswith("and 24 more columns: pandas.DataFrame(events) has all of them")
    assert "<td>1</td>" in lh.trajectory(bouncing, [0.5, 0.0], t1=4.0, n=2).events._repr_html_()


@pytest.mark.slow
def test_sections_and_return_maps_keep_the_names():
    ball = KINDS["Hybrid"](**CALLED)
    section = lh.poincare_section(ball, [1.0, 0.0], section=lambda t, x, args: x[1], n=2)
    assert section.to_xarray().state.values.tolist() == list(NAMES)
    assert lh.return_map(ball).names == NAMES
    assert lh.return_map(ball, with_time=True).names == (*NAMES, "t")


FLOWING = [kind for kind in KINDS if kind != "Map"]


@pytest.mark.slow_cases("filippov", "DAE", "Hybrid")
@pytest.mark.parametrize("kind", FLOWING)
def test_every_kind_of_system_that_flows_says_its_unit_of_time(kind):
    found, plain = (
        lh.trajectory(KINDS[kind](**CALLED, **timed), [1.0, 2.0], t1=2.0, n=2) for timed in ({"time_unit": "ms"}, {})
    )
    assert str(found) == str(plain).replace("t = 1 to 2, ", "t = 1 to 2 ms, ") != str(plain)
    data = found.to_xarray()
    assert data.attrs["time_unit"] == data.t.attrs["units"] == data.event_t.attrs["units"] == "ms"
    assert "time_unit" not in plain.to_xarray().attrs
    assert plain.to_xarray().t.attrs == {}
    assert data.unit.values.tolist() == list(UNITS)  # those of components stay
    assert [run.plot().figure.axes[-1].get_xlabel() for run in (found, plain)] == ["time t (ms)", "time t"]


@pytest.mark.slow
def test_systems_that_are_made_of_others_keep_the_unit_of_time():
    flow, ball = (KINDS[kind](**CALLED, time_unit="ms") for kind in ("Flow", "Hybrid"))
    noisy = lh.white_noise(flow, lambda t, x, args: jnp.ones(2), step=0.5, until=10.0)
    kept = [noisy]
    for node in (flow, ball):
        network = lh.coupled_network(node, lambda t, x, args: x, [[-1.0, 1.0], [1.0, -1.0]])
        assert network.units == 2 * UNITS
        kept.append(network)
    kept.append(
        lh.DAE.reduced(
            lambda t, args: jnp.ones((2, 2)), lambda t, x, args: jnp.stack([-x[0], x[1]]), **CALLED, time_unit="ms"
        )
    )
    kept.append(lh.implicit_dae(lambda t, x, dx, args: dx + x, [1.0], time_unit="ms"))
    assert [system.time_unit for system in kept] == ["ms"] * 5
    assert lh.coupled_network(lh.Map(swing), lambda t, x, args: x, [[-1.0, 1.0], [1.0, -1.0]]).time_unit is None
    section = lh.poincare_section(ball, [1.0, 0.0], section=lambda t, x, args: x[1], n=2)
    assert section.to_xarray().t.attrs["units"] == "ms"
    assert lh.return_map(ball).time_unit is None
    assert lh.return_map(ball, with_time=True).units == (*UNITS, "ms")


@pytest.mark.slow
def test_a_unit_of_time_compiles_nothing():
    """The fields are the same objects, so that only the unit of time could make a difference."""

    def energy(x, args):
        return x @ x

    def coupling(t, x, args):
        return x

    plain = lh.Flow(swing)
    timed = eqx.tree_at(lambda flow: flow.field, lh.Flow(swing, time_unit="ms"), plain.field)
    assert timed.time_unit == "ms"
    decay = lh.Flow(lambda t, x, a: -a * x)
    of_decay = eqx.tree_at(lambda flow: flow.field, lh.Flow(swing, time_unit="ms"), decay.field)
    verbs = [
        lambda flow, _: lh.lyapunov_spectrum(flow, [1.0, 2.0], t1=5.0).exponents,
        lambda flow, _: lh.trajectory(flow, [1.0, 2.0], t1=5.0, n=3).x,
        lambda flow, _: lh.floquet(flow, [1.0, 2.0], conserve=energy).period,
        lambda _, flow: lh.master_stability(flow, coupling, [1.0], 1.0, at=[-1.0], t1=5.0).exponents,
        lambda _, flow: lh.lyapunov_gradient(flow, [1.0], 1.0, t1=20.0).gradient,
    ]
    before = [verb(plain, decay) for verb in verbs]
    count = compilations()
    after = [verb(timed, of_decay) for verb in verbs]
    assert compilations() == count
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, other)


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
    with pytest.raises(ValueError, match=said):
        lh.lyapunov_gradient(system, [1.0, 2.0], 1.0, t1=1.0)


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


@pytest.mark.parametrize("kind", FLOWING)
@pytest.mark.parametrize("given", [1.0, "", " ", ("ms",), b"ms"])
def test_a_unit_of_time_that_is_none_is_refused(kind, given):
    with pytest.raises(ValueError, match='time_unit must be a string, such as "ms"; got '):
        KINDS[kind](time_unit=given)


def test_iterations_have_no_unit_of_time():
    with pytest.raises(TypeError, match="time_unit"):
        lh.Map(swing, time_unit="ms")
    with pytest.raises(ValueError, match="counts jumps: no time passes; got time_unit='ms'"):
        lh.Hybrid(None, lh.Transition(height, bounce), time_unit="ms")
