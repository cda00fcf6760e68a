"""Every verb on systems whose motion fails on the way: a result that says so, or an error of our family, no other."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid import STATUS

ARGS = {"a": 1.0}
KEY = jax.random.key(0)
T1 = 10.0


def fall(t, x, args):
    return jnp.stack([x[1], 0 * x[0] - args["a"]])


def floor(rebound):
    return lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], rebound(x[1])]))


def to_the_fold(t, x, args):
    """The last component is √x₀, and x₀ falls through zero."""
    return jnp.stack([0 * x[0] - args["a"], -x[1], x[2] ** 2 - x[0]])


CLOCKWORK = lh.EventDriven(
    flow=lambda dt, t, x, args: jnp.stack([x[0] - dt, x[1]]),
    next_event=lambda t, x, args: (jnp.where(x[1] < 2.5, x[0], jnp.nan), 0),
    jump=lambda t, x, args, which: jnp.stack([x[0] + 1.0, x[1] + args["a"]]),
    guard=lambda t, x, args, which: x[0],
)
# Each with its start and the verdicts that a run may end with.
FAILING = {
    "a map escapes": (lh.Map(lambda n, x, args: 2 * args["a"] * x**2), [1.5, 1.2], {STATUS.nonfinite}),
    "blow-up in finite time": (lh.Flow(lambda t, x, args: args["a"] * x**2), [1.0, 0.5], {STATUS.nonfinite}),
    "the field becomes nan": (
        lh.Flow(lambda t, x, args: jnp.stack([args["a"] + 0 * x[0], jnp.sqrt(2 - x[0])])),
        [0.0, 0.0],
        {STATUS.nonfinite, STATUS.stalled},
    ),
    "events accumulate": (lh.Hybrid(fall, floor(lambda v: -0.5 * v)), [0.5, 0.0], {STATUS.zeno}),
    "no way on": (lh.Hybrid(fall, floor(lambda v: 0 * v)), [0.5, 0.0], {STATUS.deadlock}),
    "a reset gives nan": (lh.Hybrid(fall, floor(jnp.sqrt)), [0.5, 0.0], {STATUS.nonfinite}),
    "a guard becomes nan": (
        lh.Hybrid(fall, lh.Transition(lambda t, x, args: 0.1 + jnp.sqrt(x[0] - 0.2), lambda t, x, args: -x)),
        [0.5, 0.0],
        {STATUS.nonfinite},
    ),
    "constraints become singular": (
        lh.DAE(lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 0.0])), to_the_fold, n_differential=2),
        [1.0, 1.0, 1.0],
        {STATUS.singular_dae},
    ),
    "a time of flight is nan": (CLOCKWORK, [1.0, 1.0], {STATUS.nonfinite}),
}  # fmt: skip
FLOWS, MAPS, HYBRIDS, DAES, CLOSED = lh.Flow, lh.Map, lh.Hybrid, lh.DAE, lh.EventDriven
ALL, SMOOTH = FLOWS | MAPS | HYBRIDS | CLOSED, FLOWS | MAPS | HYBRIDS
JUMPING = lh.Hybrid(fall, floor(lambda v: -0.9 * v))


def crossings(system, x0, **more):
    if isinstance(system, lh.Map | lh.EventDriven):
        return lh.poincare_section(system, x0, ARGS, period=1, n=50, **more)
    return lh.poincare_section(system, x0, ARGS, section=lambda t, x, args: x[1] - 0.2, n=50, **more)


def diagram(system, x0, **more):
    box = [[0.99 * x for x in x0], [1.01 * x + 0.01 for x in x0]]
    how = {"period": 1, "t1": 32, "transient": 10, "samples": 8, "key": KEY}
    return lh.bifurcation_diagram(system, box, ARGS, over={"a": [0.9, 1.1]}, **how, **more)


def swept(system, x0):
    run = lambda args: lh.lyapunov_spectrum(system, jnp.asarray(x0), args, t1=T1, blocks=4)  # noqa: E731
    return lh.sweep(run, {"a": [0.9, 1.0, 1.1]}, args=ARGS, progress=False)


def refined(system, x0):
    run = lambda args: lh.lyapunov_spectrum(system, jnp.asarray(x0), args, t1=T1, blocks=4)  # noqa: E731
    over = {"a": np.linspace(0.9, 1.1, 3), "b": np.linspace(0.0, 1.0, 3)}
    coarse = lh.sweep(run, over, args=ARGS | {"b": 0.0}, progress=False)
    return lh.refine(coarse, run, args=ARGS | {"b": 0.0}, levels=1, progress=False)


def returns(system, x0):
    return lh.lyapunov_spectrum(lh.return_map(system), jnp.asarray(x0), ARGS, t1=100, blocks=4)


def turns(system):
    """The period of a map."""
    return 5 if isinstance(system, lh.Map) else None


def coupled(t, x, args):
    """What systems that are coupled hear of each other: their first component, which jumps leave as it is."""
    return jnp.concatenate([0 * x[:1], x[:1], 0 * x[2:]])


def starts_of(system, x0, **more):
    box = [[0.99 * x for x in x0], [1.01 * x + 0.01 for x in x0]]
    return lh.basins(system, box, ARGS, starts=16, key=KEY, t1=T1, **more)


def field_of(system, x0, **more):
    box = [[0.99 * x for x in x0], [1.01 * x + 0.01 for x in x0]]
    return lh.ftle_field(system, box, ARGS, shape=[2] * len(x0), t1=T1, **more)


def angles_of(system, x0, **more):
    box = [[0.99 * x for x in x0], [1.01 * x + 0.01 for x in x0]]
    return lh.angle_field(system, box, ARGS, shape=[2] * len(x0), transient=T1, **more)


def near_the_fold(system, x0):
    return lh.consistent_start(system, [-1.0, 0.0, 1.0], ARGS)


def usual(verb):
    """The kinds of systems that a verb takes, and a short run of it; None if it needs more than a length."""
    parameters = inspect.signature(verb).parameters
    needed = {name for name, one in parameters.items() if one.default is one.empty}
    if not {"system", "x0", "t1"} <= needed <= {"system", "x0", "args", "t1"}:
        return None
    how = {"t1": T1} | ({"blocks": 4} if "blocks" in parameters else {})
    return parameters["system"].annotation, lambda s, x, **more: verb(s, x, ARGS, **how, **more)


FUNCTIONS = {name: getattr(lh, name) for name in lh.__all__ if inspect.isfunction(getattr(lh, name))}
# Each with the kinds of systems that it takes. A new verb that needs a system, a start and a length is found here by
# itself; one that needs more has its call below.
VERBS = {name: found for name, verb in FUNCTIONS.items() if (found := usual(verb)) is not None}
VERBS |= {
    "spectral_intervals": (
        ALL,
        lambda s, x, **more: lh.spectral_intervals(s, x, ARGS, t1=T1, window=5.0, tau=1.0, **more),
    ),
    "phase_response": (FLOWS | HYBRIDS, lambda s, x: lh.phase_response(s, x, ARGS, phases=8)),
    "floquet": (ALL, lambda s, x: lh.floquet(s, x, ARGS, period=turns(s))),
    "continuation": (
        FLOWS | MAPS | HYBRIDS,
        lambda s, x: lh.continuation(s, x, ARGS, over={"a": (0.5, 1.5)}, period=turns(s)),
    ),
    "lyapunov_gradient, regression": (
        ALL,
        lambda s, x: lh.lyapunov_gradient(s, x, ARGS, t1=T1, key=KEY, algorithm="regression"),
    ),
    "design": (ALL, lambda s, x: lh.design(s, x, ARGS, -0.5, over="a", t1=T1)),
    "design, bisection": (
        ALL,
        lambda s, x: lh.design(s, x, ARGS, -0.5, over={"a": (0.9, 1.1)}, t1=T1, optimiser="bisection"),
    ),
    "sweep": (ALL, swept),
    "refine": (ALL, refined),
    "return_map": (HYBRIDS, returns),
    "poincare_section": (ALL, crossings),
    "bifurcation_diagram": (MAPS | HYBRIDS | CLOSED, diagram),
    "basins": (ALL, starts_of),
    "ftle_field": (ALL, field_of),
    "angle_field": (ALL, angles_of),
    "consistent_start": (DAES, near_the_fold),
    "transverse_spectrum": (
        SMOOTH,
        lambda s, x, **more: lh.transverse_spectrum(s, x, ARGS, response=[1], t1=T1, blocks=4, **more),
    ),
    "master_stability": (
        SMOOTH,
        lambda s, x, **more: lh.master_stability(s, coupled, x, ARGS, at=[-0.1, 0.1], t1=T1, blocks=4, **more),
    ),
}
# A return map is nan where there is no return; the crossings between jumps hide from a section that these accumulate.
ALSO = {"return_map": {STATUS.nonfinite}}
# A point and no motion: what they need of it is asked before anything is computed.
OF_A_POINT = {"saltation_matrix", "jacobians"}
OF_A_RESULT = {"edge_state", "basin_shares", "bifurcation_curve"}  # of what `basins` or `continuation` finds
REPORTING = {"check", "explore"}  # say what they found, and raise nothing


def test_no_verb_is_forgotten():
    known = {name.partition(",")[0] for name in VERBS} | OF_A_POINT | OF_A_RESULT | REPORTING
    makers = {"filippov", "impact", "implicit_dae", "canonical_flow", "coupled_network", "frozen_noise", "white_noise"}
    assert known == FUNCTIONS.keys() - makers, "a verb that needs more than a length has its call in VERBS"


def the_motion_fails_in(result) -> bool:
    """Whether a result says that there is no answer, or up to where there is one."""
    if isinstance(result, lh.Solutions):
        return all(one.spectrum.status.failed for one in result.solutions)
    if hasattr(result, "trust"):  # a gradient or a design
        return not result.trust
    if hasattr(result, "data_vars"):
        return bool(np.all(result.status > 0) and np.all(np.isnan(result.exponents)))
    if isinstance(result, lh.Basins):
        return not result.attractors
    if isinstance(result, lh.BifurcationDiagram):
        return bool(np.all(np.asarray(result.status) > 0))
    return result.status.failed


def check(name: str, system, x0, verdicts: set, **more) -> None:
    """The verb on the system: what is raised holds what was computed, with the verdict of the run where there is one.

    A return map is one of few that may end well: there the accumulation is a fixed point.
    """
    raised = None
    try:
        result = VERBS[name][1](system, x0, **more)
    except lh.LyaphybridError as error:
        raised, result = error, error.result
    assert result is not None
    assert str(result)
    if isinstance(raised, lh.RunFailedError):
        assert raised.status in verdicts | ALSO.get(name, set())
        assert f"{raised.status.name}: " in str(raised)
    elif raised is None:
        assert the_motion_fails_in(result) or name == "return_map"


def takes(name: str, how: str) -> bool:
    """Some verbs are not for constraints."""
    system, unconstrained = (
        FAILING[how][0],
        ("ofli2", "transverse_spectrum", "master_stability", "phase_response", "basins", "ftle_field", "angle_field"),
    )
    return isinstance(system, VERBS[name][0]) and not (isinstance(system, lh.DAE) and name in unconstrained)


PAIRS = [(name, how) for how in FAILING for name in VERBS if takes(name, how)]


@pytest.mark.slow_cases(
    "covariant_vectors-a map escapes",
    "lyapunov_gradient, regression-a map escapes",
    "sweep-a map escapes",
    "angle_field-a map escapes",
    "refine-a map escapes",
    "bifurcation_diagram-a map escapes",
    "lyapunov_spectrum-a map escapes",
    "spectral_intervals-a map escapes",
    "design-a map escapes",
    "lyapunov_gradient-a map escapes",
    "master_stability-a map escapes",
    "svd_spectrum-a map escapes",
    "design, bisection-a map escapes",
)
@pytest.mark.parametrize(("name", "how"), [pair for pair in PAIRS if "map" in pair[1]])
def test_every_verb_on_a_map_that_escapes(name, how):
    check(name, *FAILING[how])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "how"), [pair for pair in PAIRS if "map" not in pair[1]])
def test_every_verb_on_a_motion_that_fails(name, how):
    check(name, *FAILING[how])


@pytest.mark.slow_cases(all_but=("a map escapes",))
@pytest.mark.parametrize("how", FAILING)
def test_a_check_says_that_the_motion_fails(how):
    system, x0, _ = FAILING[how]
    report = lh.check(system, x0, ARGS)
    if how == "events accumulate":  # the motion comes to rest, which is no mistake of the user
        (run,) = (finding for finding in report.findings if finding.topic == "run")
        assert report.ok, str(report)
        assert run.verdict == "note", str(report)
        assert "zeno" in run.text
    else:
        assert not report.ok, str(report)


@pytest.mark.slow
@pytest.mark.parametrize("how", FAILING)
def test_a_view_of_the_explorer_says_that_the_motion_fails(how):
    system, x0, verdicts = FAILING[how]
    view = lh.explore(system, x0, ARGS, t1=T1).view
    assert view.spectrum is not None
    assert view.spectrum.status in verdicts
    assert all(str(part) for part in (view.trajectory, view.section, view.spectrum))


# What goes well, but not in so few attempts of a step.
LONG = {
    "map": (lh.Map(lambda n, x, args: jnp.cos(args["a"] + x)), [0.3, 0.2]),
    "flow": (lh.Flow(lambda t, x, args: jnp.stack([x[1], -args["a"] * x[0]])), [1.0, 0.5]),
    "hybrid": (JUMPING, [0.5, 0.0]),
    "event-driven": (
        lh.EventDriven(
            flow=lambda dt, t, x, args: jnp.stack([x[0] - dt, x[1]]),
            next_event=lambda t, x, args: (x[0], 0),
            jump=lambda t, x, args, which: jnp.stack([x[0] + 1.0, args["a"] * x[1]]),
            guard=lambda t, x, args, which: x[0],
        ),
        [1.0, 1.0],
    ),
}
LIMITED = [name for name in VERBS if "max_steps" in inspect.signature(FUNCTIONS[name.partition(",")[0]]).parameters]
SPENT = [(name, kind) for kind, (system, _) in LONG.items() for name in LIMITED if isinstance(system, VERBS[name][0])]


@pytest.mark.slow_cases(all_but=("lyapunov_spectrum-map", "trajectory-flow"))
@pytest.mark.parametrize(("name", "kind"), SPENT)
def test_every_verb_says_that_its_attempts_are_spent(name, kind):
    check(name, *LONG[kind], {STATUS.max_steps}, max_steps=3)
