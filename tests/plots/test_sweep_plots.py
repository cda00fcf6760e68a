"""Pictures of sweeps: what is drawn is what the dataset holds, and what failed is said."""

import subprocess
import sys

import numpy as np
import pytest
import xarray
from matplotlib import pyplot
from matplotlib.colors import to_hex

import lyaphybrid as lh
from lyaphybrid import plots
from lyaphybrid.plots import sweep_arrays as arrays
from lyaphybrid.plots import sweeps as _sweep_plots
from lyaphybrid.plots.axes import COLOURS
from lyaphybrid.statuses import STATUS


def a_dataset(exponents, stderr=0.1, status=0, **axes) -> xarray.Dataset:
    """As of lh.sweep, exponents (…, k) over the axes in their order."""
    values, dims = np.asarray(exponents, float), tuple(name.replace("__", ".") for name in axes)
    known = np.broadcast_to(np.asarray(status, np.int8), values.shape[:-1])
    data = {
        "exponents": ((*dims, "exponent"), values),
        "stderr": ((*dims, "exponent"), np.broadcast_to(np.asarray(stderr, float), values.shape)),
        "status": (dims, known),
    }
    coordinates = dict(zip(dims, axes.values(), strict=True)) | {"exponent": 1 + np.arange(values.shape[-1])}
    return xarray.Dataset(data, coordinates)


def a_list(exponents, status=0, **coordinates) -> xarray.Dataset:
    found = a_dataset(np.asarray(exponents, float)[:, None], status=status, point=np.arange(len(exponents)))
    return found.assign_coords({name: ("point", np.asarray(values)) for name, values in coordinates.items()})


RATES = np.array([1.0, 2.0, 3.0, 4.0, 6.0])
PLAIN = np.stack([[0.5, 0.4, 0.3, 0.2, 0.1], [-1.0, -1.1, -1.2, -1.3, -1.4]], axis=1)


def curves(ax):
    """The data of lines with a line style, less the one at zero."""
    return [line.get_xydata() for line in ax.lines[1:] if line.get_linestyle() == "-"]


def marks(ax):
    """The places of marks by their names."""
    found = [line for line in ax.lines if line.get_linestyle() == "None" and not line.get_label().startswith("_")]
    return {line.get_label(): line.get_xdata().tolist() for line in found}


def legend(ax) -> list[str]:
    return [] if ax.get_legend() is None else [text.get_text() for text in ax.get_legend().get_texts()]


# --- lines ---------------------------------------------------------------------------------------------------------


def test_lines_are_the_exponents_and_bands_one_standard_error():
    ax = plots.sweep_lines(a_dataset(PLAIN, [0.1, 0.2], rho=RATES))
    for i, (line, band) in enumerate(zip(curves(ax), ax.collections, strict=True)):
        np.testing.assert_allclose(line, np.stack([RATES, PLAIN[:, i]], axis=1))
        (path,) = band.get_paths()
        at_two = path.vertices[path.vertices[:, 0] == 2.0, 1]
        np.testing.assert_allclose(sorted(set(at_two)), PLAIN[1, i] + [0.1, 0.2][i] * np.array([-1, 1]))
    assert ax.lines[0].get_ydata() == [0.0, 0.0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("ρ", "exponents λ$_i$")
    assert legend(ax) == ["λ$_{1}$", "λ$_{2}$"]


def test_chosen_exponents_keep_their_colours():
    found = a_dataset(PLAIN, rho=RATES)
    for chosen in ([2], 2, np.array([2])):
        ax = plots.sweep_lines(found, chosen)
        (line,) = curves(ax)
        np.testing.assert_allclose(line[:, 1], PLAIN[:, 1])
        assert ax.lines[1].get_color() == COLOURS[1]
        assert ax.get_ylabel() == "exponent λ$_{2}$"
        assert legend(ax) == []


def test_one_exponent_that_was_selected_is_drawn():
    ax = plots.sweep_lines(a_dataset(PLAIN, rho=RATES).sel(exponent=2))
    np.testing.assert_allclose(curves(ax)[0][:, 1], PLAIN[:, 1])
    assert "{2}" in ax.get_ylabel()


def test_parameters_are_put_in_order():
    order = [3, 0, 4, 2, 1]
    ax = plots.sweep_lines(a_dataset(PLAIN[order], rho=RATES[order]))
    np.testing.assert_allclose(curves(ax)[0], np.stack([RATES, PLAIN[:, 0]], axis=1))


def test_points_that_failed_are_gaps_with_the_status_at_the_foot():
    values = PLAIN.copy()
    values[[1, 3, 4]] = np.nan
    ax = plots.sweep_lines(a_dataset(values, status=[0, 5, 1, 5, 3], rho=RATES))
    np.testing.assert_allclose(curves(ax)[0][:, 1], values[:, 0])
    assert marks(ax) == {"nonfinite (2)": [2.0, 4.0], "zeno (1)": [6.0]}
    assert set(legend(ax)) == {"λ$_{1}$", "λ$_{2}$", "nonfinite (2)", "zeno (1)"}
    shapes = {line.get_label(): line.get_marker() for line in ax.lines}
    assert shapes["nonfinite (2)"] != shapes["zeno (1)"]
    low, high = ax.get_ylim()
    assert np.nanmin(values) - 0.1 > low + _sweep_plots.ROW * (high - low)


def test_points_between_gaps_are_dots_with_error_bars():
    values = PLAIN[:, :1].copy()
    values[[1, 3]] = np.nan
    ax = plots.sweep_lines(a_dataset(values, status=[0, 5, 0, 5, 0], rho=RATES))
    (bars,) = ax.containers
    np.testing.assert_allclose(bars.lines[0].get_xydata(), [[1.0, 0.5], [3.0, 0.3], [6.0, 0.1]])
    assert len(bars.lines[2][0].get_segments()) == 3


@pytest.mark.parametrize("missing", [-1, 0])
def test_points_that_were_not_computed_are_told(missing):
    values = PLAIN.copy()
    values[2] = np.nan
    ax = plots.sweep_lines(a_dataset(values, status=[0, 0, missing, 0, 0], rho=RATES))
    assert marks(ax) == {"no value (1)": [3.0]}


def test_minus_infinity_is_at_the_foot_in_a_row_an_exponent():
    values = PLAIN.copy()
    values[1:3, 1], values[2, 0] = -np.inf, -np.inf
    ax = plots.sweep_lines(a_dataset(values, rho=RATES))
    assert marks(ax) == {"λ$_{1}$ = −∞": [3.0], "λ$_{2}$ = −∞": [2.0, 3.0]}
    first, second = (line for line in ax.lines if line.get_marker() == "v")
    assert (first.get_color(), second.get_color()) == COLOURS[:2]
    assert 0 < first.get_ydata()[0] < second.get_ydata()[0] < 0.1  # of the height of the axes
    low, high = ax.get_ylim()
    lowest = np.min(values[np.isfinite(values)]) - 0.1
    assert lowest > low + 2 * _sweep_plots.ROW * (high - low)
    assert np.isnan(curves(ax)[1][1:3, 1]).all()


def test_many_exponents_of_minus_infinity_share_a_row():
    values = np.full((5, 30), -np.inf)
    values[:, 0] = 1.0
    ax = plots.sweep_lines(a_dataset(values, rho=RATES))
    assert marks(ax) == {"some λ$_{i}$ = −∞": RATES.tolist()}
    assert legend(ax)[:2] == ["λ$_{1}$", "λ$_{30}$"]  # of many lines the first and the last are named
    assert len({to_hex(line.get_color()) for line in ax.lines[1:31]}) == 30


def test_replicates_are_a_mean_and_its_standard_error():
    runs = np.array([[1.0, 3.0, np.nan], [2.0, 4.0, 6.0], [np.nan, 5.0, np.nan], [-np.inf, 1.0, 1.0], [1.0, 1.0, 1.0]])
    status = np.where(np.isnan(runs), STATUS.nonfinite, STATUS.ok)
    found = a_dataset(runs[..., None], 9.0, status, rho=RATES, key=np.arange(3))
    for one in (found, found.transpose("exponent", "key", "rho")):
        ax = plots.sweep_lines(one)
        np.testing.assert_allclose(curves(ax)[0][:, 1], [2.0, 4.0, 5.0, np.nan, 1.0])
        vertices = np.concatenate([path.vertices for path in ax.collections[0].get_paths()])
        spans = [np.ptp(vertices[vertices[:, 0] == rate, 1]) / 2 for rate in RATES[:2]]
        np.testing.assert_allclose(spans, [1.0, 2 / np.sqrt(3)])
        assert marks(ax) == {"nonfinite (3)": [1.0, 3.0], "λ$_{1}$ = −∞": [4.0]}


def test_one_replicate_has_its_own_error():
    swept = arrays.one_parameter(a_dataset(PLAIN[:, None], 0.3, rho=RATES, key=[0]))
    np.testing.assert_allclose(swept.exponents, PLAIN)
    np.testing.assert_allclose(swept.stderr, 0.3)


def test_equal_ratios_are_logarithmic():
    assert plots.sweep_lines(a_dataset(PLAIN, rho=np.geomspace(0.1, 100, 5))).get_xscale() == "log"
    for linear in (RATES, np.geomspace(1, 2, 5), -np.geomspace(0.1, 100, 5)[::-1], np.linspace(1, 100, 5)):
        assert plots.sweep_lines(a_dataset(PLAIN, rho=linear)).get_xscale() == "linear"


def test_a_list_of_points_of_one_parameter_is_a_line():
    ax = plots.sweep_lines(a_list(PLAIN[:, 0], rho=RATES))
    np.testing.assert_allclose(curves(ax)[0], np.stack([RATES, PLAIN[:, 0]], axis=1))
    both = a_list(PLAIN[:, 0], rho=RATES, beta=-RATES)
    ax = plots.sweep_lines(both.swap_dims(point="beta"))
    np.testing.assert_allclose(curves(ax)[0][:, 0], -RATES[::-1])
    assert ax.get_xlabel() == "β"


# --- maps ----------------------------------------------------------------------------------------------------------

BETA, GAP = np.array([0.0, 1.0, 3.0, 7.0]), np.array([-1.0, 0.0, 0.5])


def a_grid(status=0, **changes) -> xarray.Dataset:
    """Exponents −1 … 1.2 with (i, j) → −1 + 0.2 (3i + j), and a second one below."""
    values = (-1 + 0.2 * np.arange(12.0)).reshape(4, 3)
    for place, value in changes.items():
        values[int(place[1]), int(place[2])] = value
    return a_dataset(np.stack([values, values - 5.0], axis=-1), status=status, spring__beta=BETA, gap=GAP)


def mesh_of(ax):
    return next(one for one in ax.collections if hasattr(one, "get_coordinates"))


def areas(ax):
    """The area of the cells of each status, by its name."""
    found = {}
    for patch in ax.patches:
        boxes = patch.get_path().vertices.reshape(-1, 5, 2)
        found[patch.get_label()] = float(np.sum(np.prod(boxes[:, 2] - boxes[:, 0], axis=1)))
    return found


def test_a_map_has_cells_around_its_values():
    ax = plots.sweep_map(a_grid())
    mesh = mesh_of(ax)
    np.testing.assert_allclose(mesh.get_coordinates()[0, :, 0], [-0.5, 0.5, 2.0, 5.0, 9.0])
    np.testing.assert_allclose(mesh.get_coordinates()[:, 0, 1], [-1.5, -0.5, 0.25, 0.75])
    np.testing.assert_allclose(mesh.get_array()[1, 2], -1 + 0.2 * (3 * 2 + 1))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("β", "gap")
    assert ax.get_xlim() == (-0.5, 9.0)
    assert ax.get_ylim() == (-1.5, 0.75)
    assert ax.figure.axes[1].get_ylabel() == "exponent λ$_{1}$"
    assert legend(ax) == []


def test_a_map_of_another_exponent_and_in_another_order():
    found = a_grid().isel(gap=[2, 0, 1]).transpose("exponent", "gap", "spring.beta")
    ax = plots.sweep_map(found, 2)
    np.testing.assert_allclose(mesh_of(ax).get_array()[3, 1], -6 + 0.2 * (3 * 3 + 1))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("gap", "β")
    assert ax.figure.axes[1].get_ylabel() == "exponent λ$_{2}$"


def test_zero_is_white_and_the_signs_have_a_hue_each():
    mesh = mesh_of(plots.sweep_map(a_grid(_00=0.0)))
    assert to_hex(mesh.cmap(mesh.norm(0.0))) == "#ffffff"
    below, above = (mesh.cmap(mesh.norm(value)) for value in (-0.5, 0.5))
    assert below[2] > below[0]
    assert above[0] > above[2]


def test_outliers_do_not_set_the_limits():
    values = np.linspace(-1, 1, 300).reshape(20, 15, 1)
    values[3, 3], values[4, 4] = 1e6, -1e6
    ax = plots.sweep_map(a_dataset(values, a=np.arange(20), b=np.arange(15)))
    mesh = mesh_of(ax)
    assert -1 < mesh.norm.vmin < -0.9
    assert 0.9 < mesh.norm.vmax < 1
    assert mesh.colorbar.extend == "both"


def test_errors_around_zero_stay_pale():
    mesh = mesh_of(plots.sweep_map(a_dataset(-np.ones((3, 3, 1)), a=np.arange(3), b=np.arange(3))))
    assert (mesh.norm.vmin, mesh.norm.vmax) == (-1.0, 0.1)
    assert mesh.colorbar.ax.get_ylim() == (-1.0, 0.0)
    assert mesh.colorbar.extend == "neither"


@pytest.mark.parametrize("value", [0.0, np.nan, -np.inf])
def test_maps_without_a_scale(value):
    ax = plots.sweep_map(a_dataset(np.full((3, 3, 1), value), a=np.arange(3), b=np.arange(3)))
    assert (mesh_of(ax).norm.vmin, mesh_of(ax).norm.vmax) == (-1.0, 1.0)


def test_minus_infinity_is_the_colour_below_the_bar():
    ax = plots.sweep_map(a_grid(_00=-np.inf))
    mesh = mesh_of(ax)
    drawn = mesh.cmap(mesh.norm(mesh.get_array()))
    assert to_hex(drawn[0, 0]) == _sweep_plots.UNDER
    others = drawn.reshape(-1, 4)[1:]
    assert all(to_hex(one) != _sweep_plots.UNDER for one in others)
    assert mesh.colorbar.extend in ("min", "both")
    assert [text.get_text() for text in mesh.colorbar.ax.texts] == ["−∞"]


def test_points_that_failed_are_grey_cells_with_a_legend():
    status = np.zeros((4, 3), int)
    status[1:3, 1], status[3, 2], status[0, 0], status[0, 1] = 5, 3, -1, 1
    found = a_grid(status, _11=np.nan, _21=np.nan, _32=np.nan, _00=np.nan)
    ax = plots.sweep_map(found)
    widths, heights = [1.0, 1.5, 3.0, 4.0], [1.0, 0.75, 0.5]
    expected = {"no value (1)": widths[0] * heights[0], "zeno (1)": widths[3] * heights[2]}
    assert areas(ax) == pytest.approx(expected | {"nonfinite (2)": (widths[1] + widths[2]) * heights[1]})
    assert legend(ax) == ["no value (1)", "zeno (1)", "nonfinite (2)"]
    assert np.ma.getmaskarray(mesh_of(ax).get_array()).sum() == 4
    inside = ax.patches[2].get_path()
    assert inside.contains_points([(1.0, 0.0), (3.0, 0.0)]).all()
    assert not inside.contains_points([(1.0, 0.5), (7.0, 0.0)]).any()


def test_every_status_that_fails_has_a_look_of_its_own():
    failing = [int(status) for status in STATUS if status.failed]
    assert set(_sweep_plots.STATUS_STYLES) == {*failing, arrays.NO_VALUE}
    kinds = _sweep_plots.STATUS_STYLES.values()
    for looks in ([kind.marker for kind in kinds], [kind.grey for kind in kinds], [kind.hatch for kind in kinds]):
        assert len(set(looks)) == len(looks)
    assert "v" not in [kind.marker for kind in kinds]  # −∞
    codes = [-1, *failing, 100]
    codes = np.array([*codes, *[-1] * (len(codes) % 2)]).reshape(2, -1)
    values, m = np.full((*codes.shape, 1), np.nan), codes.shape[1]
    assert "status 100 (1)" in legend(plots.sweep_map(a_dataset(values, status=codes, a=[0, 1], b=np.arange(m))))
    plots.sweep_lines(a_dataset(values.reshape(2 * m, 1), status=codes.ravel(), a=np.arange(2 * m)))


def test_geometric_grids_have_geometric_cells():
    ax = plots.sweep_map(a_dataset(np.ones((3, 4, 1)), a=[0, 1, 2], b=[0.01, 0.1, 1.0, 10.0]))
    assert (ax.get_xscale(), ax.get_yscale()) == ("linear", "log")
    np.testing.assert_allclose(mesh_of(ax).get_coordinates()[:, 0, 1], 10 ** np.array([-2.5, -1.5, -0.5, 0.5, 1.5]))


def test_a_parameter_of_one_value_has_a_cell():
    mesh = mesh_of(plots.sweep_map(a_dataset(np.ones((3, 1, 1)), a=[0, 1, 2], b=[5.0])))
    np.testing.assert_allclose(mesh.get_coordinates()[:, 0, 1], [4.5, 5.5])


def test_a_point_of_a_list_has_the_part_of_the_plane_nearest_to_it():
    a, b = (one.ravel() for one in np.meshgrid([0.0, 0.1, 0.2, 0.3], [0.0, 100.0, 200.0], indexing="ij"))
    values = np.arange(12.0) - 5
    status = np.where(np.arange(12) == 7, STATUS.zeno, STATUS.ok)
    ax = plots.sweep_map(a_list(np.where(status == 3, np.nan, values), status, a=a, omega=b))
    mesh = mesh_of(ax)
    across, upwards = mesh.get_coordinates()[0, :, 0], mesh.get_coordinates()[:, 0, 1]
    assert (across[0], across[-1], upwards[0], upwards[-1]) == pytest.approx((0.0, 0.3, 0.0, 200.0))

    def drawn(x, y):
        return mesh.get_array()[np.searchsorted(upwards, y) - 1, np.searchsorted(across, x) - 1]

    low = mesh.norm.vmin
    for i in range(12):
        if i != 7:
            x, y = np.clip(a[i] + 0.03, 0, 0.299), np.clip(b[i] - 30.0, 1, 199)
            assert drawn(x, y) == max(values[i], low)
    assert drawn(0.21, 90.0) is np.ma.masked
    assert areas(ax) == pytest.approx({"zeno (1)": 0.1 * 100.0}, rel=0.02)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("a", "ω")
    np.testing.assert_allclose(ax.lines[0].get_xydata(), np.stack([a, b], axis=1))


def test_far_from_all_points_nothing_is_claimed():
    t = np.linspace(0, 1, 100)
    array = mesh_of(plots.sweep_map(a_list(1 + t, a=t, b=t**2))).get_array()
    blank = np.ma.getmaskarray(array)
    assert blank[-1, 0]
    assert blank[0, -1]
    assert not blank[0, 0]
    assert not blank[-1, -1]
    a, b = np.random.default_rng(0).uniform(size=(2, 400))
    assert not np.ma.getmaskarray(mesh_of(plots.sweep_map(a_list(a, a=a, b=b))).get_array()).any()


def test_few_and_equal_points_have_cells():
    for count in (1, 2, 3):
        x = np.arange(float(count))
        assert mesh_of(plots.sweep_map(a_list(x + 1, a=x, b=0 * x))).get_array().count() > 0


# --- both ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("rho", "ρ"),
        ("a.b", "b"),
        ("deep.spring.omega", "ω"),
        ("Omega", "Ω"),
        ("lambda_", "λ"),
        ("beta[2]", "β[2]"),
        ("rates[0]", "rates[0]"),
        ("omega_f", "omega_f"),
        ("restitution", "restitution"),
    ],
)
def test_labels(name, shown):
    assert arrays.label(name) == shown


def test_what_was_read_back_is_drawn_alike(tmp_path):
    status = np.zeros((4, 3), np.int8)
    status[2, 1] = 5
    found = a_grid(status, _21=np.nan, _00=-np.inf)
    found.to_zarr(tmp_path / "sweep.zarr", consolidated=False)
    for back in (found, xarray.open_zarr(tmp_path / "sweep.zarr", consolidated=False)):
        ax = plots.sweep_map(back)
        assert legend(ax) == ["nonfinite (1)"]
        assert np.ma.getmaskarray(mesh_of(ax).get_array()).sum() == 1
        ax = plots.sweep_lines(back.isel(gap=1))
        assert marks(ax) == {"nonfinite (1)": [3.0]}


@pytest.mark.slow
def test_what_a_sweep_returns_is_drawn():
    def run(args):
        return lh.lyapunov_spectrum(lh.Map(lambda n, x, args: args["r"] * x * (1 - x)), [0.3], args, t1=64, blocks=8)

    over, args = {"r": np.array([2.9, 3.9, 4.5]), "s": np.array([0.0, 1.0])}, {"r": 3.0, "s": 0.0}
    found = lh.sweep(run, over, args=args, progress=False)
    ax = plots.sweep_map(found)
    assert legend(ax) == ["nonfinite (2)"]
    assert ax.figure.axes[1].get_ylabel() == "exponent λ$_{1}$ per iteration"
    line = curves(plots.sweep_lines(found.sel(s=1.0)))[0]
    np.testing.assert_allclose(line[:, 1], found.exponents.sel(s=1.0)[:, 0])
    listed = lh.sweep(run, points={"r": [2.9, 3.9, 4.5], "s": [0.0, 1.0, 0.0]}, args=args, progress=False)
    assert legend(plots.sweep_map(listed)) == ["nonfinite (1)"]


def test_axes_that_are_given_are_used_and_nothing_else():
    figure, axes = pyplot.subplots(1, 2)
    current = pyplot.gca()
    assert plots.sweep_lines(a_dataset(PLAIN, rho=RATES), ax=axes[0]) is axes[0]
    assert plots.sweep_map(a_grid(), ax=axes[1]) is axes[1]
    assert pyplot.get_fignums() == [figure.number]
    assert len(figure.axes) == 3  # a colour bar
    assert pyplot.gca() is current


def test_the_legend_is_no_wider_than_the_axes():
    status = [int(one) for one in STATUS if one.failed]
    values = np.full((len(status), 1), np.nan)
    ax = plots.sweep_lines(a_dataset(values, status=status, a=np.arange(len(status))))
    ax.figure.canvas.draw()
    assert ax.get_legend().get_window_extent().width < ax.bbox.width


@pytest.mark.slow
def test_xarray_is_not_needed_to_import_plots():
    code = "import sys; sys.modules['xarray'] = None; from lyaphybrid import plots; plots.sweep_map"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


GRID = a_grid()
CUBE = a_dataset(np.zeros((2, 2, 2, 1)), a=[0, 1], b=[0, 1], c=[0, 1])
LISTED = a_list(np.zeros(3), a=np.arange(3.0), b=np.arange(3.0))


@pytest.mark.parametrize(
    ("draw", "dataset", "says"),
    [
        (plots.sweep_lines, GRID, r"the dataset has spring.beta \(4\), gap \(3\).*dataset.isel\(gap=0\).*sweep_map"),
        (plots.sweep_lines, CUBE, r"a \(2\), b \(2\), c \(2\)\. Select values of the others.*sel\(b=… and c=…\)"),
        (plots.sweep_lines, GRID.isel({"spring.beta": 0, "gap": 0}), "none: all were selected. Take what lh.sweep"),
        (plots.sweep_lines, LISTED, r"a, b change together.*dataset.swap_dims\(point='a'\), or draw them with sweep_m"),
        (plots.sweep_map, CUBE, r"draws over two parameters; the dataset has a \(2\), b \(2\), c \(2\).*sel\(c=…\)"),
        (plots.sweep_map, CUBE.isel(a=0, b=0, c=0), "none: all were selected"),
        (plots.sweep_map, CUBE.isel(a=0, b=0), "along the dimension 'c' the dataset has c. Draw it with sweep_lines"),
        (plots.sweep_map, LISTED.assign_coords(c=("point", [1, 2, 3])), r"has a, b, c\. Leave two.*drop_vars\('c'\)"),
        (plots.sweep_map, LISTED.drop_vars(["a", "b"]), "has none. Draw it with sweep_lines"),
        (plots.sweep_lines, GRID.drop_vars("exponents"), "no exponents, it has stderr, status: the run"),
        (plots.sweep_map, GRID.exponents, "Dataset that lh.sweep returns; got DataArray"),
        (plots.sweep_map, 3.0, "got float"),
    ],
)
def test_bad_datasets(draw, dataset, says):
    with pytest.raises(ValueError, match=says):
        draw(dataset)
    assert pyplot.get_fignums() == []


@pytest.mark.parametrize("chosen", [0, 3, [1, 3], [], "first", 1.5])
def test_exponents_that_are_not_there(chosen):
    for draw, dataset in ((plots.sweep_lines, GRID.isel(gap=0)), (plots.sweep_map, GRID)):
        with pytest.raises(ValueError, match="has the exponents 1, 2, numbered from 1; got"):
            draw(dataset, chosen)
