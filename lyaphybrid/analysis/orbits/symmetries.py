"""Symmetries modulo which an orbit closes: x(T) = g(x0), as a runner has the same posture one step further.

A symmetry is one transformation g(x), or a group g(x, s), whose s after one period is one more unknown.
"""

import inspect
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._arguments import require
from ..._jax.precision import digits
from ...systems.daes.semi_linear import Constrained, fields_of
from ...systems.smooth import Map

__all__ = ["Symmetry", "symmetry_of"]

NEWTON_ITERATIONS = 4  # Newton iterations for the group element that maps one state nearest to another
EQUAL_FIELDS = 1e-9  # relative tolerance of the comparison of a field with its image
LEAST_SINGULAR_RATIO = 1e-10  # least ratio of singular values of an invertible transformation
SAMPLE_DISTANCE = 0.1  # relative distance from x of the states at which a symmetry is checked
SAMPLE_STATES = 3  # number of these states


class _One(eqx.Module):
    transformation: Callable

    def __call__(self, x, shift):
        del shift
        return self.transformation(x)


class _Group(eqx.Module):
    transformation: Callable

    def __call__(self, x, shift):
        return self.transformation(x, shift[0])


class _Translation(eqx.Module):
    components: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, x, shift):
        return x.at[jnp.array(self.components)].add(shift)


class Image(NamedTuple):
    """The image of a point under a transformation, and its derivatives."""

    x: np.ndarray  # (n,)
    by_state: np.ndarray  # (n, n)
    by_shift: np.ndarray  # (n, q)


class Symmetry(NamedTuple):
    """The transformation x ↦ action(x, shift)."""

    action: Callable  # (x (n,), shift (q,)) -> (n,)
    freedom: int  # q: 0 for one transformation

    def image(self, x, shift=None) -> Image:
        """The image of a point; without a shift, under the identity of the group."""
        shift = np.zeros(self.freedom) if shift is None else shift
        x = jnp.asarray(x)
        return Image(*map(np.asarray, _image(self.action, x, jnp.asarray(shift, x.dtype))))

    def back(self, x, shift) -> np.ndarray:
        """The point whose image is x."""
        before = np.asarray(x)
        for _ in range(NEWTON_ITERATIONS):
            image = self.image(before, shift)
            before = before + np.linalg.solve(image.by_state, np.asarray(x) - image.x)
        return before

    def followed(self, x, points, units) -> tuple[np.ndarray, np.ndarray]:
        """Distances of the points (samples, n) of a motion from the nearest image of x, in units (n,); its shifts."""
        x = jnp.asarray(x)
        zero, units = jnp.zeros(self.freedom, x.dtype), jnp.asarray(units, x.dtype)
        distances, shifts = _followed(self.action, x, zero, jnp.asarray(points, x.dtype), units)
        return np.asarray(distances), np.asarray(shifts)


@eqx.filter_jit
def _image(action, x, shift):
    return action(x, shift), *jax.jacfwd(action, argnums=(0, 1))(x, shift)


@eqx.filter_jit
def _followed(action, x, zero, points, units):
    def nearest(shift, point):
        for _ in range(NEWTON_ITERATIONS):
            along = jax.jacfwd(action, argnums=1)(x, shift) / units[:, None]
            miss = (point - action(x, shift)) / units
            normal = along.T @ along
            shift = shift + jnp.linalg.pinv(normal, hermitian=True) @ (along.T @ miss)
        return shift, (jnp.linalg.norm((point - action(x, shift)) / units), shift)

    return jax.lax.scan(nearest, zero, points)[1]


def symmetry_of(modulo: Any, system, x, args, t) -> Symmetry | None:
    """The user's symmetry, checked: it is invertible and maps motions to motions.

    Args:
        modulo: None, a component or several, ``g(x) -> x`` or ``g(x, s) -> x``.
        system: an `lh.Flow`, `lh.Hybrid` or `lh.Map`.
        x: (n,) a state.
        args: pytree of parameters.
        t: a time.

    Raises:
        ValueError: on what is no symmetry of the system.
    """
    if modulo is None:
        return None
    symmetry, named = _meant(modulo, len(x))
    _check_action(symmetry, x)
    random = np.random.default_rng(0)
    size = SAMPLE_DISTANCE * (np.abs(x) + SAMPLE_DISTANCE * max(1.0, float(np.max(np.abs(x)))))
    for _ in range(SAMPLE_STATES):
        beside = jnp.asarray(np.asarray(x) + size * random.normal(size=len(x)), x.dtype)
        _check_fields(symmetry, named, system, beside, args, t, random.normal(size=symmetry.freedom))
    return symmetry


def _meant(modulo: Any, n: int) -> tuple[Symmetry, str]:
    """The symmetry, and its name for messages."""
    wanted = (
        "modulo must be a component that grows (its index), several of them, a function g(x) with x(T) = g(x0), or a "
        "group g(x, s) whose s is to be found"
    )
    if callable(modulo):
        return Symmetry(*((_Group(modulo), 1) if _takes_two(modulo, wanted) else (_One(modulo), 0))), "g"
    several: Sequence[Any] = modulo if isinstance(modulo, list | tuple) else [modulo]
    good = len(several) > 0 and all(isinstance(i, int | np.integer) and not isinstance(i, bool) for i in several)
    require(good, f"{wanted}; got {modulo!r}.")
    inside = all(0 <= i < n for i in several) and len(set(several)) == len(several)
    require(inside, f"{wanted}. The components of x go from 0 to {n - 1}, each may be named once; got {modulo!r}.")
    return Symmetry(_Translation(tuple(int(i) for i in several)), len(several)), f"a shift of component {modulo}"


def _takes_two(function: Callable, wanted: str) -> bool:
    """Whether the function takes (x, s) instead of (x)."""
    for two in (False, True):
        try:
            inspect.signature(function).bind(*([None] * (1 + two)))
        except TypeError:
            continue
        return two
    raise ValueError(f"{wanted}; got a function with other arguments than (x) or (x, s).")


def _check_action(symmetry: Symmetry, x) -> None:
    shape = jax.ShapeDtypeStruct(x.shape, x.dtype)
    result = jax.eval_shape(symmetry.action, shape, jax.ShapeDtypeStruct((symmetry.freedom,), x.dtype))
    good = getattr(result, "shape", None) == x.shape and result.dtype == x.dtype
    require(good, f"modulo: g must return a state like x, {x.shape} of {x.dtype}; got {result}.")
    image = symmetry.image(x)
    singular = np.linalg.svd(image.by_state, compute_uv=False)
    invertible = np.all(np.isfinite(singular)) and singular[-1] > digits(LEAST_SINGULAR_RATIO, x) * singular[0]
    require(bool(invertible), f"modulo: it must be possible to undo g; its derivative at x = {x} is singular.")
    if symmetry.freedom:
        still = np.max(np.abs(image.x - np.asarray(x))) <= digits(EQUAL_FIELDS, x) * (1 + np.max(np.abs(x)))
        require(bool(still), f"modulo: g(x, 0) must be x, the identity of the group; got {image.x} at x = {x}.")
        moves = bool(np.any(image.by_shift))
        require(moves, f"modulo: g(x, s) must move x with s; at x = {x} it does not depend on s.")


def _check_fields(symmetry: Symmetry, named: str, system, x, args, t, shift) -> None:
    """Require that the fields of all modes, or the rule, at the image of x equal the images of their values."""
    time, there = jnp.asarray(t, x.dtype), symmetry.image(x, shift)
    image = jnp.asarray(there.x)
    if isinstance(system, Map):
        found, own = (np.asarray(system.rule(time, at, args)) for at in (image, x))
        expected = symmetry.image(own, shift).x
        return _require_same(named, "rule", x, found, expected, np.max(np.abs(own)) + np.max(np.abs(there.x)))
    for name, field in zip(getattr(system, "mode_names", ("flow",)), fields_of(system), strict=True):
        if not isinstance(field, Constrained):
            found, own = (np.asarray(field(time, at, args)) for at in (image, x))
            terms = np.max(np.abs(there.by_state) @ np.abs(own)) + np.max(np.abs(found))
            _require_same(named, f"field of mode {name!r}", x, found, there.by_state @ own, terms)
    return None


def _require_same(named: str, name: str, x, found: np.ndarray, expected: np.ndarray, terms: float) -> None:
    apart = np.abs(found - expected)  # nan where a field is not defined beside the orbit; passes
    require(
        not np.max(apart) > digits(EQUAL_FIELDS, x) * terms,
        f"modulo must be a symmetry of the system, which takes motions to motions; got {named} that is none: at x = "
        f"{x} the {name} at the image of x is {found}, where that of x, carried along, is {expected}. Likely "
        "causes: (a) the system depends on what is changed (a slope, a wall, a mass); (b) velocities must be turned or "
        "mirrored along with positions; (c) only some shifts are symmetries (2π of an angle): give that one, g(x).",
    )
