"""The event log: appending to it, and choosing between two of them, copies no rows."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid.analysis.trajectories import EVENT_LOG_ROWS
from lyaphybrid.engine.states import EventLog, empty_log, log_event, log_events, select
from lyaphybrid.native.machine import tiers

ENTRY = EventLog(jnp.asarray(0, jnp.int32), *jnp.array([0.5, 1.5, 2.5, 3.5, 4.5]), jnp.array([5.5, 6.5]), jnp.zeros(2))
LOG = jax.tree.map(lambda one: jnp.zeros((4, *one.shape), one.dtype), ENTRY)._replace(count=ENTRY.count)


def test_a_short_log_is_appended_to_a_long_one():
    short = empty_log(LOG, 3)
    for _ in range(2):
        short = log_event(short, ENTRY)
    long = log_events(log_event(LOG, ENTRY), short)
    assert int(long.count) == 3
    assert long.t.tolist() == [0.5, 0.5, 0.5, 0.0]
    assert long.x_before.tolist() == [[5.5, 6.5]] * 3 + [[0.0, 0.0]]
    assert empty_log(None, 3) is None
    assert log_events(None, None) is None


def test_what_is_the_same_is_not_selected():
    same = jnp.arange(3.0)
    program = jax.make_jaxpr(lambda x, y: select(y > 0, (x, y), (x, -y)))(same, jnp.asarray(1.0))
    assert len(program.jaxpr.eqns) == 3  # y > 0, −y and one selection


@pytest.mark.parametrize("walls", [1, 2])
def test_no_step_copies_the_log(walls, monkeypatch):
    """It is copied in and out of the program; in each block and at each event it took ten times as long as the rest."""
    texts, make = [], tiers.Tiers.__init__
    monkeypatch.setattr(
        tiers.Tiers, "__init__", lambda self, text, *rest: (texts.append(text), make(self, text, *rest))[0]
    )
    wall = [
        lh.Transition(lambda t, x, a, i=i: x[0] + i, lambda t, x, a: jnp.stack([x[0], -x[1]])) for i in range(walls)
    ]
    ball = lh.Hybrid(lambda t, x, a: jnp.stack([x[1], -a + 0 * x[0]]), wall)
    run = lh.trajectory(ball, [0.5, 0.0], 1.0 + 0.01 * walls, t1=5.0, n=50)
    assert len(run.events.t) > 2
    rows = 8 * np.size(run.x[0]) * EVENT_LOG_ROWS
    program = max(texts, key=len)
    copies = re.findall(rf"memcpy[^\n]*i64 {rows}, i1", program)
    assert 0 < len(copies) <= 4  # the states before and after events, in and out
