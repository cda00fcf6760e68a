"""Angles between covariant vectors over grids of starts: closed forms, singular vectors, `lh.covariant_vectors`."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from numpy.testing import assert_allclose, assert_array_equal

import lyaphybrid as lh
from interrupts import only_computed

HENON = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]), names=("x", "y"))
NEAR = [[-0.1, -0.1], [0.1, 0.1]]
PRECISE = lh.RungeKutta("dop853", rtol=1e-12, atol=1e-14)


@pytest.mark.slow
def test_the_cat_map():
    """Each iteration is the same matrix: the angle is that of its eigenvectors, at all starts and along the orbit."""
    matrix = np.array([[3.0, 2.0], [1.0, 1.0]])
    vectors = np.linalg.eig(matrix)[1]
    angle = np.arccos(abs(vectors[:, 0] @ vectors[:, 1]))
    cat = lh.Map(lambda n, x, args: (matrix @ x) % 1.0)
    inverse = lh.Map(lambda n, x, args: (np.linalg.inv(matrix) @ x) % 1.0)
    for how in ({}, {"t1": 6}, {"inverse": inverse, "transient": 14}):
        found = lh.angle_field(cat, [[0.0, 0.0], [1.0, 1.0]], shape=(3, 4), **{"transient": 20} | how)
        assert_allclose(found.angles, np.full((3, 4), angle), rtol=1e-12)
        assert_array_equal(found.status_code, 0)
    assert np.max(found.missed) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("split", [1, 2, 3])
def test_subspaces_of_a_linear_map(split):
    vectors = np.random.default_rng(3).standard_normal((4, 4))
    matrix = vectors @ np.diag([2.0, 1.1, 0.5, 0.2]) @ np.linalg.inv(vectors)
    system = lh.Map(lambda n, x, args: matrix @ x)
    box = [[0.0, 1.0, 0.3, 0.2], [1.0, 1.0, 0.3, 0.2]]
    found = lh.angle_field(system, box, shape=(2,), transient=50, split=split)
    wanted = np.min(scipy.linalg.subspace_angles(vectors[:, :split], vectors[:, split:]))
    assert_allclose(found.angles, wanted, rtol=1e-10)
    rates = np.log([2.0, 1.1, 0.5, 0.2])
    assert_allclose(np.log(found.remainder), -50 * (rates[split - 1] - rates[split]), rtol=0, atol=3.0)
    assert np.ptp(found.remainder) < 1e-9 * found.remainder[0]


@pytest.mark.slow
def test_regular_motion_has_no_two_spans():
    """A rotation: nothing converges, which the remainder says; the picture leaves the angles out."""
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    found = lh.angle_field(lh.Map(lambda n, x, args: turn @ x), [[0.0, 0.0], [1.0, 1.0]], shape=(2, 2), transient=50)
    assert_allclose(found.remainder, 1.0, rtol=1e-12)
    assert "4 angles with a remainder above 0.001" in str(found)
    assert np.all(np.ma.getmaskarray(np.ma.masked_invalid(found.plot().collections[0].get_array())))


def bent(p):
    """A diffeomorphism of the plane."""
    x = p[0] + 0.3 * p[1] ** 2
    return jnp.stack([x, p[1] + 0.4 * x**2])


def straight(q):
    y = q[1] - 0.4 * q[0] ** 2
    return jnp.stack([q[0] - 0.3 * y**2, y])


def angle_of_images(points):
    """The angle at these points between the images of the two axes, in closed form."""
    axes = jax.vmap(lambda q: jax.jacfwd(bent)(straight(q)))(points.reshape(-1, 2))
    along, across = np.asarray(axes).transpose(2, 0, 1)
    crossed = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    return np.arctan2(np.abs(crossed), np.abs(np.sum(along * across, axis=1))).reshape(points.shape[:-1])


def baker(n, q, args):
    """The baker's map in bent coordinates: unstable and stable directions are the images of the axes."""
    x, y = straight(q)
    return bent(jnp.stack([2 * x % 1.0, (y + jnp.floor(2 * x)) / 2]))


def baker_back(n, q, args):
    x, y = straight(q)
    return bent(jnp.stack([(x + jnp.floor(2 * y)) / 2, 2 * y % 1.0]))


BAKER, BAKER_BACK = lh.Map(baker), lh.Map(baker_back)
INSIDE = [[0.31, 0.32], [0.63, 0.61]]


@pytest.mark.slow
def test_bent_bakers_at_the_image_and_at_the_start():
    at_image = lh.angle_field(BAKER, INSIDE, shape=(5, 4), transient=24)
    assert_allclose(at_image.angles, angle_of_images(at_image.where), rtol=0, atol=1e-12)
    assert np.ptp(at_image.angles) > 0.2
    assert at_image.missed is None
    at_start = lh.angle_field(BAKER, INSIDE, shape=(5, 4), transient=24, inverse=BAKER_BACK)
    grid = np.stack(np.meshgrid(*at_start.axes.values(), indexing="ij"), axis=-1)
    assert_allclose(at_start.where, grid, rtol=0, atol=1e-7)
    assert_allclose(at_start.angles, angle_of_images(grid), rtol=0, atol=1e-6)
    assert np.max(at_start.missed) < 1e-7


@pytest.mark.slow
def test_the_least_on_the_way_of_bent_bakers():
    found = lh.angle_field(BAKER, INSIDE, shape=(3, 2), transient=24, t1=8, inverse=BAKER_BACK)
    for at in np.ndindex(3, 2):
        points = [jnp.array([found.axes[i][at[i]] for i in (0, 1)])]
        for _ in range(8):
            points.append(baker(0, points[-1], None))
        wanted = angle_of_images(np.array(points))
        assert found.time[at] == np.argmin(wanted)
        assert found.angles[at] == pytest.approx(np.min(wanted), abs=1e-5)
        assert_allclose(found.where[at], points[int(found.time[at])], atol=1e-5)
    assert np.max(found.time) > 0


def to_and_fro(kept):
    """x' = x, y' = −1.5 y, and at x = 1 back to x = 0.2 with another y; kept = 0 forgets y."""
    return lh.Hybrid(
        lambda t, x, args: jnp.stack([x[0], -1.5 * x[1]]),
        lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: jnp.stack([0.2 * x[0], kept * x[1] + 0.3])),
        names=("x", "y"),
    )


@pytest.mark.slow
@pytest.mark.parametrize("kept", [0.5, 0.0])
def test_a_hybrid_flow_in_closed_form(kept):
    """The flow is one covariant vector, through its saltation matrices; y alone, which contracts, is the other."""
    box = [[0.3, 0.1], [0.9, 1.3]]
    found = lh.angle_field(to_and_fro(kept), box, shape=(3, 2), transient=18.0, method=PRECISE)
    x, y = np.moveaxis(found.where, -1, 0)
    assert_allclose(found.angles, np.arctan2(x, 1.5 * y), rtol=0, atol=1e-10)
    assert np.ptp(found.angles) > 0.1


@pytest.mark.slow
def test_starts_off_the_attractor_of_a_hybrid_flow():
    """Their past leads to y = ±∞, and there the flow is not what grows most, but (x, −1.5 y*(x)), y* the attractor."""
    back = lh.Hybrid(
        lambda t, x, args: jnp.stack([-x[0], 1.5 * x[1]]),
        lh.Transition(lambda t, x, args: x[0] - 0.2, lambda t, x, args: jnp.stack([5 * x[0], 2 * (x[1] - 0.3)])),
    )
    box = [[0.3, 0.1], [0.9, 1.3]]
    found = lh.angle_field(to_and_fro(0.5), box, shape=(3, 2), transient=18.0, method=PRECISE, inverse=back)
    after_reset = 0.3 / (1 - 0.5 * 5**-1.5)
    x = found.axes[0][:, None]
    wanted = np.arctan2(x, 1.5 * after_reset * (x / 0.2) ** -1.5)
    assert_allclose(found.angles, np.broadcast_to(wanted, (3, 2)), rtol=0, atol=1e-9)


@pytest.mark.slow
def test_the_henon_map_as_covariant_vectors_have_it():
    found = lh.angle_field(HENON, NEAR, 1.4, shape=(2, 2), transient=60, settle=80, t1=10)
    for at in np.ndindex(2, 2):
        x0 = [found.axes[i][at[i]] for i in (0, 1)]
        one = lh.covariant_vectors(HENON, x0, 1.4, t1=20, blocks=20, transient=60, settle=60)
        angles = np.asarray(one.angles)[:11, 0]
        assert_allclose(found.angles[at], np.min(angles), rtol=0, atol=1e-9)
        assert found.time[at] == np.argmin(angles)
        assert_allclose(found.where[at], one.x[np.argmin(angles)], rtol=0, atol=1e-12)


OSCILLATOR = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], jnp.cos(2.8 * t) - 0.1 * x[1] - x[0]]),
    lh.Transition(lambda t, x, args: -x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]])),
)


@pytest.mark.slow
def test_an_impact_oscillator_as_covariant_vectors_have_it():
    box = [[-0.5, 0.1], [-0.1, 0.6]]
    how = {"settle": 50.0, "method": PRECISE}
    found = lh.angle_field(OSCILLATOR, box, shape=(2, 2), transient=50.0, t1=10.0, blocks=120, **how)
    for at in np.ndindex(2, 2):
        x0 = [found.axes[i][at[i]] for i in (0, 1)]
        one = lh.covariant_vectors(OSCILLATOR, x0, transient=0.5, t1=59.5, blocks=119, **how)  # the same steps
        angles, x = np.asarray(one.angles)[99:, 0], np.asarray(one.x)[99:]
        assert_allclose(found.angles[at], np.min(angles), rtol=0, atol=1e-9)
        assert found.time[at] == pytest.approx(0.5 * np.argmin(angles), abs=1e-12)
        assert_allclose(found.where[at], x[np.argmin(angles)], rtol=0, atol=1e-9)


def ball(sign):
    """An elastic ball in gravity that changes with time; sign −1: on the clock −t."""
    return lh.Hybrid(
        lambda t, x, args: sign * jnp.stack([x[1], 0.8 * jnp.cos(t) - 1.0]),
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
    )


@pytest.mark.slow
def test_at_starts_the_directions_are_those_that_contract_to_and_fro():
    """Independent of all frames: right singular vectors of the two tangent maps, through impacts."""
    box, t0, length = [[0.2, -1.0], [1.6, 1.0]], 0.4, 60.0
    found = lh.angle_field(ball(1), box, shape=(4, 4), transient=length, inverse=ball(-1), t0=t0, method=PRECISE)
    grid = np.stack(np.meshgrid(*found.axes.values(), indexing="ij"), axis=-1).reshape(-1, 2)

    def contracting(sign):
        how = {"t1": length, "t0": sign * t0, "method": PRECISE}
        run = lambda args, x0: {"matrix": lh.tangent_map(ball(sign), x0, **how).matrix}  # noqa: E731
        matrices = lh.sweep(run, points={"x0": grid}, progress=None)["matrix"].values
        _, sizes, directions = np.linalg.svd(matrices)
        return sizes[:, 0], directions[:, 1]

    (ahead, stable), (behind, unstable) = contracting(1), contracting(-1)
    wanted = np.arccos(np.abs(np.sum(stable * unstable, axis=1)))
    settled = np.minimum(ahead, behind) > 1e4  # to about 100 σ⁻²
    assert np.sum(settled) >= 6
    assert_allclose(found.angles.ravel()[settled], wanted[settled], rtol=0, atol=1e-5)
    assert np.all(found.remainder.ravel()[settled] < 1e-5)
    assert np.all(found.remainder.ravel()[np.minimum(ahead, behind) < 100] > 1e-5)


@pytest.mark.slow
def test_starts_that_fail_are_told():
    found = lh.angle_field(HENON, [[0.0, 0.0], [4.0, 0.1]], 1.4, shape=(4, 1), transient=30)
    codes = [lh.STATUS(int(code)) for code in found.status_code[:, 0]]
    assert codes[0] == lh.STATUS.ok
    assert codes[3] == lh.STATUS.nonfinite
    assert found.status == lh.STATUS.nonfinite
    assert_array_equal(np.isnan(found.angles[:, 0]), [code.failed for code in codes])
    assert np.all(np.isnan(found.where[3]))
    assert f"{codes.count(lh.STATUS.nonfinite)} starts nonfinite" in str(found)


@pytest.mark.slow
def test_starts_whose_past_fails_are_told():
    back = lh.Map(lambda n, x, a: jnp.stack([x[1] / 0.3, x[0] - 1 + a * (x[1] / 0.3) ** 2]))
    found = lh.angle_field(HENON, [[-1.0, -0.5], [1.0, 0.5]], 1.4, shape=(3, 3), transient=30, inverse=back)
    assert np.sum(found.status_code == lh.STATUS.nonfinite) >= 4  # off the attractor the past escapes
    assert np.all(np.isnan(found.angles[found.status_code != 0]))


@pytest.mark.slow
def test_a_field_is_resumed_and_becomes_a_dataset(tmp_path):
    how = {"transient": 20, "shape": (6, 4), "store": tmp_path / "field.zarr", "chunk": 8}
    found = lh.angle_field(HENON, NEAR, 1.4, **how)
    again = lh.angle_field(HENON, NEAR, 1.4, **how)
    assert_array_equal(found.angles, again.angles)
    data = found.to_xarray()
    assert data["angles"].dims == ("x", "y")
    assert data["angles"].attrs == {"units": "rad"}
    assert_array_equal(data["x"], found.axes[0])
    with pytest.raises(ValueError, match="another sweep"):
        lh.angle_field(HENON, NEAR, 1.4, settle=21, **how)


@pytest.mark.slow
def test_pictures_at_points_and_at_starts():
    found = lh.angle_field(HENON, NEAR, 1.4, shape=(6, 4), transient=20)
    ax = found.plot()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x", "y")
    assert_allclose(ax.collections[0].get_offsets(), found.where.reshape(-1, 2))
    assert_allclose(np.ma.filled(found.plot(within=1.0).collections[0].get_array()), found.angles.ravel())
    assert ax.figure.axes[1].get_ylabel() == "angle between vectors"
    found = lh.angle_field(BAKER, INSIDE, shape=(5, 4), transient=12, inverse=BAKER_BACK)
    assert_allclose(np.asarray(found.plot().collections[0].get_array()).ravel(), found.angles.T.ravel())
    assert "the starts were met again to" in str(found)
    line = lh.angle_field(HENON, [[-0.1, 0.0], [0.1, 0.0]], 1.4, shape=(3,), transient=20)
    with pytest.raises(ValueError, match="two components"):
        line.plot()


@pytest.mark.slow
def test_starts_that_are_missed_are_told():
    with pytest.warns(UserWarning, match="20 starts were not met again"):
        lh.angle_field(BAKER, INSIDE, shape=(5, 4), transient=10, inverse=BAKER)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lh.angle_field(BAKER, INSIDE, shape=(5, 4), transient=10, inverse=BAKER_BACK)


FLOW = lh.Flow(lambda t, x, args: -x)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"x0": [0.0, 1.0]}, r"two corners of a box of starts, \(2, n\)"),
        ({"shape": (3,)}, "one number for each of the 2 varied components"),
        ({"transient": 0}, "transient, a length, must be positive"),
        ({"transient": 2.5}, "transient counts iterations here"),
        ({"settle": -1}, "settle, a length, must be positive"),
        ({"t1": -1}, "t1, a length, must be zero or positive"),
        ({"split": 0}, "split must be an integer of at least 1"),
        ({"split": 2}, "split must be at most 1, for 2 vectors"),
        ({"blocks": 0}, "blocks must be an integer of at least 1"),
        ({"blocks": 3}, "a piece, .* counts iterations here"),
        ({"inverse": 3.0}, "inverse must be a system like the first, one that iterates; got float"),
        ({"inverse": FLOW}, "inverse must be a system like the first, one that iterates; got Flow"),
        ({"method": lh.RungeKutta()}, "takes no method"),
        ({"system": FLOW, "method": lh.ContinuousQR(lh.RungeKutta())}, "give the method within it"),
        ({"system": 3.0}, "system must be"),
        ({"max_steps": 0}, "max_steps"),
    ],
)
def test_what_cannot_be_is_refused(change, words):
    how = {"system": HENON, "x0": NEAR, "args": 1.4, "transient": 20, "shape": (3, 3)} | change
    with pytest.raises((ValueError, TypeError), match=words):
        lh.angle_field(**how)


@pytest.mark.slow
def test_modes_are_carried_back():
    """The ball in two modes by turns, which are alike but for a third component that only contracts in one of them."""

    def by_turns(sign):
        fall = ball(sign)
        rates = {"even": 0.0, "odd": 0.6}
        fields = {
            name: lambda t, x, args, rate=rate: jnp.append(fall.fields[0](t, x[:2], args), -sign * rate * x[2])
            for name, rate in rates.items()
        }
        reset = lambda t, x, args: jnp.array([1.0, -1.0, 1.0]) * x  # noqa: E731
        turns = [
            lh.Transition(lambda t, x, args: x[0], reset, source=a, target=b)
            for a, b in (("even", "odd"), ("odd", "even"))
        ]
        return lh.Hybrid(fields, turns)

    box = [[0.3, -0.5, 1.0], [0.9, 0.5, 1.0]]
    how = {"shape": (2, 2), "transient": 20.0, "method": PRECISE, "inverse": by_turns(-1), "split": 1}
    for mode in ("even", "odd"):
        found = lh.angle_field(by_turns(1), box, mode=mode, **how)
        assert_allclose(found.where[..., 2], 1.0, rtol=1e-7)  # the same modes to and fro, or it would have changed
        assert np.max(found.missed) < 1e-7


def test_an_inverse_has_the_same_modes():
    def modes(*names):
        leave = lh.Transition(lambda t, x, args: x[0], source=names[0], target=names[1])
        return lh.Hybrid(dict.fromkeys(names, lambda t, x, args: -x), leave)

    with pytest.raises(ValueError, match=r"inverse must have the modes of the system, \['a', 'b'\]"):
        lh.angle_field(modes("a", "b"), NEAR, shape=(2, 2), transient=1.0, mode="a", inverse=modes("a", "c"))


@pytest.mark.slow
def test_what_was_not_computed_is_interrupted(monkeypatch):
    only_computed(monkeypatch, 4)
    found = lh.angle_field(HENON, NEAR, 1.4, transient=10, shape=(3, 3))
    assert found.status == lh.STATUS.interrupted
    assert np.sum(np.isnan(found.angles)) == 5
