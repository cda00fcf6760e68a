"""The table of schemes: each row has the order that it claims, and keeps dq∧dp."""

import functools
import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid._jax.engines import compiled
from lyaphybrid.integrators.hamiltonian.splittings import PART_A, PART_B, SCHEMES
from lyaphybrid.integrators.hamiltonian.symplectic import moved
from lyaphybrid.systems.bound import Bound


def quadratic(p, args):
    return jnp.sum(p**2 * jnp.array([1.0, 0.7])) / 2


def relativistic(p, args):
    return jnp.sum(jnp.sqrt(1 + p**2))


def quartic(q, args):
    return (q[0] ** 2 + q[1] ** 2) / 2 + q[0] ** 2 * q[1] - q[1] ** 3 / 3 + 0.1 * q[0] ** 4


X0 = np.array([0.3, -0.2, 0.25, 0.35])


@functools.cache
def field_of(system):
    """The field, its parts traced once for all schemes and stages."""
    parts = {name: jax.jit(getattr(system.field, name)) for name in ("velocity", "force", "slope_of_bracket")}
    return Bound(SimpleNamespace(**parts), None)


@compiled()
def _after(system, name, steps, t):
    field, h = field_of(system), t / steps.astype(float)
    return jax.lax.fori_loop(0, steps, lambda _, x: moved(SCHEMES[name], field, x, h), jnp.asarray(X0))


def after(system, name, steps, t=2.0):
    """The state at t from a certain start; one program for all numbers of steps."""
    return _after(system, name, np.asarray(steps), t)


@compiled()
def jacobian_of_a_step(name):
    field = field_of(NEWTONIAN)
    return jax.jacfwd(lambda x: moved(SCHEMES[name], field, x, 0.1))(jnp.asarray(X0))


GENERAL = lh.Hamiltonian(relativistic, quartic)
NEWTONIAN = lh.Hamiltonian(quadratic, quartic)


@functools.cache
def exact(system):
    return after(system, "SRKN14a" if system is NEWTONIAN else "SuzukiUmeno8", 512)


STEPS = {2: (64, 128, 256), 4: (32, 64, 128), 6: (12, 24, 48), 8: (10, 14, 20), "SRKN": (4, 6, 9)}


@pytest.mark.parametrize("name", SCHEMES)
def test_order(name):
    """Halving the step divides the error by 2^order, for a kinetic energy as general as the scheme allows."""
    scheme = SCHEMES[name]
    system = NEWTONIAN if scheme.quadratic else GENERAL
    steps = STEPS["SRKN" if "SRKN" in name else scheme.order]
    errors = [np.max(np.abs(after(system, name, n) - exact(system))) for n in steps]
    slopes = -np.diff(np.log(errors)) / np.diff(np.log(steps))
    print(name, errors, slopes)
    assert errors[-1] > 1e-14
    assert np.all(slopes > scheme.order - 0.3)
    assert slopes[-1] < scheme.order + 1.3


def kicks(scheme):
    """Where the kicks stand in the step, and how strong they are."""
    at, found = 0.0, []
    for part, share in scheme.parts:
        if part == PART_A:
            at += share
        else:
            found.append((at, share))
    return np.array(found).T


PERTURBED = {f"SABA{n}": 2 * n for n in range(1, 11)} | {f"SBAB{n}": 2 * n for n in range(1, 11)}
PERTURBED |= {"ABA864": 8, "ABA1064": 10}


@pytest.mark.parametrize(("name", "order"), PERTURBED.items())
def test_order_in_the_first_power_of_a_perturbation(name, order):
    """For A + εB the term linear in ε is a quadrature over the motion under A."""
    nodes, weights = kicks(SCHEMES[name])
    for power in range(order):
        assert abs(weights @ nodes**power - 1 / (power + 1)) < 1e-13, power
    assert abs(weights @ nodes**order - 1 / (order + 1)) > 1e-14


def test_the_constants_that_are_published():
    c1, c2 = 0.5 - 1 / (2 * math.sqrt(3)), 1 / math.sqrt(3)
    assert_allclose([share for _, share in SCHEMES["SABA2"].parts], [c1, 0.5, c2, 0.5, c1], atol=1e-15)
    assert_allclose([share for _, share in SCHEMES["SBAB2"].parts], [1 / 6, 0.5, 2 / 3, 0.5, 1 / 6], atol=1e-15)
    assert_allclose(SCHEMES["SABA2C"].corrector, (2 - math.sqrt(3)) / 24, atol=1e-15)
    assert_allclose(SCHEMES["SBAB2C"].corrector, 1 / 72, atol=1e-15)
    assert_allclose(SCHEMES["SABA1C"].corrector, 1 / 12, atol=1e-15)
    assert_allclose(SCHEMES["SBAB1C"].corrector, -1 / 24, atol=1e-15)


@pytest.mark.parametrize("name", SCHEMES)
def test_rows_are_symmetric_and_complete(name):
    scheme = SCHEMES[name]
    assert_allclose(scheme.parts, scheme.parts[::-1], atol=1e-15)
    assert all(a != b for (a, _), (b, _) in zip(scheme.parts, scheme.parts[1:], strict=False))
    for part in (PART_A, PART_B):
        assert_allclose(sum(share for which, share in scheme.parts if which == part), 1.0, atol=1e-14)
    assert "doi:" in scheme.source


@pytest.mark.parametrize("name", SCHEMES)
def test_a_step_keeps_the_symplectic_form(name):
    jacobian = jacobian_of_a_step(name)
    omega = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    assert_allclose(jacobian.T @ omega @ jacobian, omega, atol=1e-14)
