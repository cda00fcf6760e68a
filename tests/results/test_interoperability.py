"""Results in xarray, NetCDF, zarr and pandas; right sides of diffrax and SciPy: the same numbers everywhere."""

import builtins

import diffrax
import jax.numpy as jnp
import numpy as np
import pandas
import pytest
import scipy.integrate
import xarray
from test_family import KINDS, SLOW

import lyaphybrid as lh
from docstring_examples import made_by_example


def parts_joined(data: xarray.Dataset) -> xarray.Dataset:
    """The complex variables of a file put together again."""
    for name in [str(name) for name in data.data_vars if str(name).endswith("_real")]:
        whole = name.removesuffix("_real")
        data = data.assign({whole: data[name] + 1j * data[f"{whole}_imag"]}).drop_vars([name, f"{whole}_imag"])
    return data


@pytest.mark.slow_cases(*SLOW)
@pytest.mark.parametrize("name", KINDS)
def test_a_result_comes_back_from_files_as_it_was(name, tmp_path):
    result = made_by_example(KINDS[name])
    data = result.to_xarray()
    result.to_netcdf(tmp_path / "result.nc")
    data.to_zarr(tmp_path / "result.zarr", zarr_format=2)
    with xarray.open_dataset(tmp_path / "result.nc") as found, xarray.open_zarr(tmp_path / "result.zarr") as stored:
        for one in (parts_joined(found), stored):
            xarray.testing.assert_equal(data, one)
            for attribute, value in data.attrs.items():
                np.testing.assert_array_equal(one.attrs[attribute], value)
    if data.sizes:
        assert data.to_dataframe().shape[0] == np.prod(list(data.sizes.values()))


def test_complex_numbers_are_written_as_two(tmp_path):
    rotation = lh.Map(lambda n, x, a: a * jnp.stack([x[0] - x[1], x[0] + x[1]]))
    found = lh.floquet(rotation, [0.0, 0.0], 0.5, period=1)
    found.to_netcdf(tmp_path / "orbit.nc")
    with xarray.open_dataset(tmp_path / "orbit.nc") as data:
        np.testing.assert_allclose(np.abs(data.multipliers_real), 0.5)
        np.testing.assert_allclose(sorted(data.multipliers_imag), [-0.5, 0.5])


def test_without_xarray_the_extra_is_named(monkeypatch, tmp_path):
    found, known = (
        lh.floquet(lh.zoo.henon_map().system, [0.6, 0.2], {"a": 1.4, "b": 0.3}, period=1),
        builtins.__import__,
    )

    def missing(name, *rest, **named):
        if name == "xarray":
            raise ImportError(name)
        return known(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", missing)
    for call in (found.to_xarray, lambda: found.to_netcdf(tmp_path / "orbit.nc")):
        with pytest.raises(ImportError, match=r"pip install 'lyaphybrid\[xarray\]'"):
            call()


BALL = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
    lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
    names=("height", "speed"),
)


def test_events_are_a_table():
    events = lh.trajectory(BALL, [0.5, 0.0], t1=8.0, n=4).events
    table = pandas.DataFrame(events)
    both = [f"{name}_{side}" for side in ("before", "after") for name in ("height", "speed")]
    assert list(table) == ["t", "transition", "which", "mode_before", "mode_after", *both]
    np.testing.assert_allclose(table.t, [1.0, 3.0, 5.0, 7.0], atol=1e-9)  # the ball falls for 1, flies for 2
    np.testing.assert_allclose(table.speed_before, -1.0, atol=1e-9)
    np.testing.assert_allclose(table.speed_after, 1.0, atol=1e-9)
    assert table.transition.dtype.kind == "i"
    assert len(pandas.DataFrame(lh.trajectory(BALL, [0.5, 0.0], t1=0.5, n=4).events)) == 0


def test_events_of_many_bodies_have_a_column_for_each_number():
    problem = lh.zoo.hard_disks(n=2)
    events = problem.trajectory(t1=3.0).events
    table = pandas.DataFrame(events)
    assert len(table) == len(events) > 0
    flat = np.reshape(events.x_after, (len(events), -1))
    np.testing.assert_array_equal(
        table[[name for name in table if name.endswith("_after") and name != "mode_after"]], flat
    )


def swing(t, y, args):
    return jnp.stack([y[1], -args["k"] * y[0]])


def right_side(t, y, k):
    """As `scipy.integrate.solve_ivp` takes it."""
    return [y[1], -k * y[0]]


def test_a_term_of_diffrax_is_a_flow():
    flow = lh.Flow(diffrax.ODETerm(swing).vector_field)
    found = lh.trajectory(flow, [1.0, 0.0], {"k": 4.0}, t1=1.0, n=5)
    np.testing.assert_allclose(found.x[:, 0], np.cos(2 * np.asarray(found.t)), atol=1e-8)


def test_a_right_side_of_scipy_is_a_flow():
    flow = lh.Flow(lambda t, x, args: jnp.stack(right_side(t, x, *args)))
    found = lh.trajectory(flow, [1.0, 0.0], (4.0,), t1=1.0, n=5)
    theirs = scipy.integrate.solve_ivp(right_side, (0, 1), [1.0, 0.0], args=(4.0,), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found.x[-1], theirs.y[:, -1], atol=1e-7)
    np.testing.assert_allclose(found.x[-1], [np.cos(2), -2 * np.sin(2)], atol=1e-8)
