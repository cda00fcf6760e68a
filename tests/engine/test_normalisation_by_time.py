"""Event-driven systems orthonormalised at fixed times, between the events: what comes out does not depend on when."""

import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid.engine import preparation, problems
from lyaphybrid.engine.blocks import qr_schedule_for, targets_for
from lyaphybrid.engine.evolvers.scheduled import predicting_anew
from lyaphybrid.engine.host import driver

DISKS = lh.zoo.hard_disks()
EVERY = ("time", 0.01)  # of Table I: ten time steps of 0.001


class Orthonormalisation(NamedTuple):
    """How many orthonormalisations there were, and how far from a multiple of the interval."""

    count: jnp.ndarray
    off: jnp.ndarray


class Counting:
    """A `Watch` of the instants of orthonormalisations."""

    def init(self, t, frame):
        return Orthonormalisation(jnp.asarray(0), jnp.zeros_like(t))

    def update(self, state, seen):
        off = jnp.abs(seen.t / EVERY[1] - jnp.round(seen.t / EVERY[1]))
        return Orthonormalisation(state.count + 1, jnp.maximum(state.off, off))

    def moved(self, state, source):
        return state

    def next_block(self, state):
        return state

    def __hash__(self):
        return 1

    def __eq__(self, other):
        return isinstance(other, Counting)


def turns(factor):
    """Each turn of length 1 the second component is multiplied, in between it grows; the third one decays."""
    return lh.EventDriven(
        lambda dt, t, x, r: jnp.stack([x[0] - dt, x[1] * jnp.exp(0.1 * dt), x[2] * jnp.exp(-40 * dt)]),
        lambda t, x, r: (x[0], 0),
        lambda t, x, r, which: jnp.stack([jnp.ones_like(t), factor * x[1], x[2]]),
        lambda t, x, r, which: x[0],
    )


SYSTEMS = {"schedule": DISKS.system, "no schedule": predicting_anew(DISKS.system, DISKS.x0.shape)}


@pytest.mark.slow_cases("no schedule")
@pytest.mark.parametrize("name", SYSTEMS)
def test_it_is_done_at_the_multiples_of_the_interval_and_only_there(name):
    problem, x0, t0, mode = preparation.prepare(SYSTEMS[name], DISKS.x0, DISKS.args, 0.0, None, None)
    qr_schedule, interval = qr_schedule_for(problem, EVERY)
    plan = problems.RunPlan(qr_schedule=qr_schedule, observer=Counting())
    loop_state = driver.start(problem, plan, t0, x0, jnp.eye(x0.shape[0]), mode, jnp.asarray(interval))
    targets = targets_for(np.array([1.0, 2.5]), "time", False, x0.dtype)
    outcome = driver.drive(problem, plan, loop_state, *targets)
    seen = outcome.loop_state.carry.observer
    assert int(outcome.loop_state.carry.jumps) > 20
    assert float(seen.off) < 1e-9
    assert int(seen.count) == 250
    assert_allclose(problems.time_of(outcome.loop_state), 2.5, rtol=1e-15)


@pytest.mark.slow
def test_the_motion_and_the_exponents_are_those_of_any_other_interval():
    """R of a product is the product of the R: only rounding may differ, which chaos multiplies by e^(4.9 t)."""
    keywords = {"t1": 1.0, "blocks": 4}
    by_jumps = lh.lyapunov_spectrum(DISKS.system, DISKS.x0, DISKS.args, every=1, **keywords)
    by_time = lh.lyapunov_spectrum(DISKS.system, DISKS.x0, DISKS.args, every=EVERY, **keywords)
    assert int(by_time.jumps) == int(by_jumps.jumps) >= 10
    assert_allclose(by_time.x, by_jumps.x, atol=1e-9)
    assert_allclose(by_time.exponents, by_jumps.exponents, atol=1e-8)
    assert_allclose(by_time.history.exponents, by_jumps.history.exponents, atol=1e-8)


@pytest.mark.slow
def test_a_direction_that_an_event_destroys_is_lost_there():
    """Exponents per unit of time: 0 of the phase, 0.1 + ln r, −40; and −∞ where r = 0."""
    kept, lost = (lh.lyapunov_spectrum(turns(r), [1.0, 0.0, 0.0], t1=50.0, every=("time", 0.3)) for r in (0.5, 0.0))
    assert_allclose(kept.exponents, [0.0, 0.1 + math.log(0.5), -40.0], rtol=1e-12, atol=1e-12)
    assert kept.status is lh.STATUS.ok
    assert not kept.notes
    assert_allclose(lost.exponents, [0.0, -40.0, -np.inf], rtol=1e-12, atol=1e-12)
    assert int(lost.losses[2]) in (49, 50)  # the fiftieth is at the end of the run


@pytest.mark.slow_cases("2.0", "1.0", "3.7")
@pytest.mark.parametrize("every", [0.3, 1.0, 2.0, 3.7])
def test_events_between_two_orthonormalisations(every):
    """Each event that may destroy a direction makes one due; the next flight was then flown as if it had no event."""
    found = lh.lyapunov_spectrum(turns(0.0), [1.0, 0.0, 0.0], t1=50.0, blocks=4, every=("time", every))
    assert int(found.jumps) in (49, 50)
    assert_allclose(found.exponents, [0.0, -40.0, -np.inf], rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_bodies_whose_collisions_might_destroy_directions():
    """The same with a schedule: what is promised changes nothing but where it is looked for."""
    system = dataclasses.replace(DISKS.system, canonical=False)
    runs = [lh.trajectory(system, DISKS.x0, DISKS.args, t1=2.0, n=1).x[-1].ravel()]
    for every in (0.1, 0.7):
        s = lh.lyapunov_spectrum(system, DISKS.x0, DISKS.args, t1=2.0, blocks=2, k=2, every=("time", every))
        assert int(s.jumps) > 20
        runs.append(np.ravel(s.x))
    assert_allclose(runs[1], runs[0], atol=1e-7)
    assert_allclose(runs[2], runs[0], atol=1e-7)


def test_a_run_by_jumps_ends_where_there_are_none_any_more():
    """A body passes its only gate: time would go on alone for ever."""
    flies = lh.EventDriven(
        lambda dt, t, x, args: x + dt,
        lambda t, x, args: (jnp.where(x[0] < 1.0, 1.0 - x[0], jnp.inf), 0),
        lambda t, x, args, which: 2.0 * x,
        lambda t, x, args, which: 1.0 - x[0],
    )
    found = lh.lyapunov_spectrum(flies, [0.0], t1=10, clock="jumps", every=("time", 0.25), throw=False)
    assert found.status is lh.STATUS.no_more_jumps
    assert int(found.jumps) == 1


@pytest.mark.slow
def test_the_exponents_of_table_one_by_its_own_normalisation():
    """Within five standard errors of the reference, from sixteen runs; and six zeros, exactly paired."""
    starts = jnp.stack([lh.zoo.hard_disks(key=key).x0 for key in jax.random.split(jax.random.key(5), 16)])
    found = lh.lyapunov_spectrum(DISKS.system, starts, DISKS.args, t1=20.0, transient=5.0, every=EVERY)
    values, errors = np.asarray(found.exponents), np.asarray(found.stderr)
    reference = np.asarray(DISKS.reference.exponents)
    moving = np.abs(reference) > 0.01
    assert np.max(errors) < 0.1
    assert np.max(np.abs(values - reference)[moving] / errors[moving]) < 5
    assert np.max(np.abs(values[~moving])) < 1e-9
