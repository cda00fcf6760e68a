"""Networks of neurons: two forms of each, avalanches, states in which they fire in turn, stable and unstable chaos."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo
from lyaphybrid.zoo.switched.sparse_networks import random_targets

MODELS = ("leaky", "xif", "qif")
BY_HAND = {"leaky": lambda x: 2 - x, "xif": lambda x: 2 + x, "qif": lambda v: v * v + 2}  # x' at I = 2


def random_matrix(seed, n, strength, connected):
    """Each of the others reaches a neuron with that probability; connected 1: all of them, unequally."""
    rng = np.random.default_rng(seed)
    there = (rng.random((n, n)) < connected) & ~np.eye(n, dtype=bool)
    return np.where(there, strength * rng.uniform(0.5, 1.5, (n, n)), 0.0)


def both(**parameters):
    return [zoo.integrate_and_fire(form=form, **parameters) for form in ("hybrid", "event_driven")]


def run_both(length, **parameters):
    return [problem.spectrum(t1=length, transient=0.0) for problem in both(**parameters)]


def assert_same(hybrid, closed):
    assert hybrid.status == closed.status == lh.STATUS.ok
    assert_allclose(closed.exponents, hybrid.exponents, rtol=0, atol=1e-9)
    assert_allclose(closed.x, hybrid.x, rtol=0, atol=1e-7)
    # So many directions are lost; on which of the replaced ones a later loss falls rounding decides.
    assert np.sum(closed.losses) == np.sum(hybrid.losses)
    assert np.array_equal(np.asarray(closed.losses) > 0, np.asarray(hybrid.losses) > 0)
    assert ("rank_lost" in closed.notes) == ("rank_lost" in hybrid.notes) == bool(jnp.any(hybrid.losses))


# One neuron, and one spike.


@pytest.mark.parametrize("model", MODELS)
def test_the_neurons_solve_their_equations(model):
    """The flow by AD, in the potential V of the equation, and from just above reset to threshold in the time said."""
    system = zoo.integrate_and_fire(model=model, form="event_driven").system
    field = zoo.integrate_and_fire(model=model).system.fields[0]
    args, x = {"current": jnp.asarray(2.0), "coupling": jnp.asarray(-0.1)}, jnp.array([0.3, -0.2])

    def potential(x):
        return math.sqrt(2) * jnp.tan(x / 2) if model == "qif" else x

    def moved(dt):
        return system.flow(dt, 0.0, x, args)

    later, velocity = jax.jvp(moved, (0.2,), (1.0,))
    assert_allclose(velocity, field(0.0, later, args), rtol=1e-14)
    assert_allclose(jax.jvp(potential, (later,), (velocity,))[1], BY_HAND[model](potential(later)), rtol=1e-14)
    dt, which = system.next_event(0.0, later, args)
    assert which == 0
    landed = system.flow(dt, 0.0, later, args)
    assert_allclose(landed[0], math.pi if model == "qif" else 1.0, rtol=1e-14)
    assert_allclose(system.guard(0.0, landed, args, which), 0.0, atol=1e-14)


def test_a_pulse_adds_to_the_potential_of_a_quadratic_neuron():
    """Also next to threshold and reset, where V is infinite, and by rounding beyond."""
    fire = zoo.integrate_and_fire(model="qif", n=3).system.transitions[0].reset

    def kicked(phase, strength):
        args = {"current": jnp.asarray(2.0), "coupling": jnp.asarray(strength)}
        return fire(0.0, jnp.array([math.pi, phase, 0.1]), args, jnp.asarray(0, jnp.int32))[1]

    for phase, strength in itertools.product([-2.0, 0.3, 3.0], [-5.0, 0.5]):
        expected = 2 * math.atan(math.tan(phase / 2) + strength / math.sqrt(2))
        assert_allclose(kicked(phase, strength), expected, rtol=1e-14)
    for phase in (math.pi + 1e-14, math.pi - 1e-14, -math.pi):
        assert_allclose(kicked(phase, 3.0), phase, rtol=1e-13)


@pytest.mark.parametrize("model", ["leaky", "xif"])
def test_an_anti_leaky_neuron_thrown_beyond_its_fixed_point_never_fires(model):
    problem = zoo.integrate_and_fire(model=model, form="event_driven")
    dt, _ = problem.system.next_event(0.0, jnp.array([-2.1, -2.5]), problem.args)
    assert np.isposinf(dt) == (model == "xif")


SPIKES = [  # coupling, topology, of neuron 2: what the others get
    (0.2, "all", [0.2, 0.2, 0.2, 0.2]),
    (-0.2, "ring", [0.0, -0.2, -0.2, 0.0]),
    (0.01 * (np.arange(25.0).reshape(5, 5) * (1 - np.eye(5))), "all", [0.02, 0.07, 0.17, 0.22]),
]


@pytest.mark.parametrize("form", ["hybrid", "event_driven"])
@pytest.mark.parametrize(("coupling", "topology", "expected"), SPIKES, ids=["all", "ring", "matrix"])
def test_whom_a_spike_reaches(form, coupling, topology, expected):
    problem = zoo.integrate_and_fire(n=5, coupling=coupling, topology=topology, form=form)
    fire = problem.system.jump if form == "event_driven" else problem.system.transitions[0].reset
    x = jnp.array([0.1, 0.2, 1.0, 0.3, 0.4])
    after = np.asarray(fire(0.0, x, problem.args, jnp.asarray(2, jnp.int32)))
    assert after[2] == 0
    assert_allclose(np.delete(after - x, 2), expected, atol=1e-15)


def test_a_ring_closes():
    problem = zoo.integrate_and_fire(n=5, topology="ring", form="event_driven")
    after = problem.system.jump(0.0, jnp.array([1.0, 0.5, 0.5, 0.5, 0.5]), problem.args, jnp.asarray(0, jnp.int32))
    assert_allclose(after, [0, 0.4, 0.5, 0.5, 0.4], atol=1e-15)


# Avalanches.


def by_hand(x, first, matrix):
    """Mirollo & Strogatz: each fires once at most and stays at reset, in plain Python."""
    x, fired, which = np.array(x), set(), first
    while True:
        fired.add(which)
        for i in range(len(x)):
            x[i] = 0.0 if i in fired else x[i] + matrix[i, which]
        above = np.flatnonzero(x > 1)
        if not len(above):
            return x, fired
        which = int(above[0])


@pytest.mark.slow
def test_an_avalanche_in_closed_form_and_as_a_cascade():
    """Of all sizes, through a matrix of both signs, where the order decides; the engine's and that of the jump."""
    n = 6
    rng = np.random.default_rng(1)
    sizes = set()
    for _ in range(12):
        matrix = rng.uniform(-0.1, 0.4, (n, n)) * (1 - np.eye(n))
        x = rng.uniform(0.3, 0.95, n)
        first = int(np.argmax(x))
        hybrid, closed = both(n=n, coupling=matrix)
        x += (1 - 1e-9) - x[first]  # just below threshold
        expected, fired = by_hand(x, first, matrix)
        sizes.add(len(fired))
        jump = closed.system.jump(0.0, jnp.asarray(x).at[first].set(1.0), closed.args, jnp.asarray(first, jnp.int32))
        assert_allclose(jump, expected, atol=1e-8)
        log = lh.trajectory(hybrid.system, x, hybrid.args, t1=1e-6, n=2).events
        assert set(np.asarray(log.which).tolist()) == fired
        assert len(log) == len(fired)
        assert_allclose(log.x_after[-1], expected, atol=1e-8)
    assert {1, n} <= sizes
    assert len(sizes) >= 4


@pytest.mark.slow
def test_the_derivative_through_an_avalanche():
    """Both tangent maps are those of central differences, and lose one direction less than fire."""
    n, h = 5, 1e-6
    x = np.array([0.3, 0.9, 0.25, 0.85, 0.8])
    hybrid, closed = both(n=n, coupling=0.12)
    found = [lh.tangent_map(p.system, x, p.args, t1=0.2) for p in (hybrid, closed)]

    def end(x):
        return np.asarray(lh.tangent_map(closed.system, x, closed.args, t1=0.2).x)

    differences = np.stack([(end(x + h * e) - end(x - h * e)) / (2 * h) for e in np.eye(n)], axis=1)
    for tangent in found:
        assert_allclose(tangent.matrix, differences, atol=1e-8)
    assert_allclose(found[0].matrix, found[1].matrix, atol=1e-13)
    assert np.linalg.matrix_rank(found[0].matrix, tol=1e-9) == n - 2


# The two forms.


@pytest.mark.slow
@pytest.mark.parametrize("coupling", [-0.1, 0.1])
def test_both_forms_have_the_same_exponents(coupling):
    assert_same(*run_both(10.0, n=4, coupling=coupling, topology="ring"))


@pytest.mark.slow
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("topology", ["all", "ring", "matrix"])
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("n", [2, 3, 8, 20])
def test_both_forms_have_the_same_exponents_everywhere(model, topology, sign, n):
    """Over few spikes of a neuron where neighbours separate: rounding must not decide who fires."""
    strength = sign * {"leaky": 0.5, "xif": 0.3, "qif": 1.0}[model] / n
    coupling = strength if topology != "matrix" else random_matrix(n, n, 2 * strength, 0.5)
    length = {"leaky": 8.0, "xif": 3.0, "qif": 15.0}[model]
    parameters = {"model": model, "n": n, "coupling": coupling, "topology": "ring" if topology == "ring" else "all"}
    hybrid, closed = run_both(length, **parameters)
    assert_same(hybrid, closed)
    assert "unresolved" not in closed.notes
    if np.max(closed.spread) < 20:  # else one jump leaves so little of a direction that it may look lost
        assert "unresolved" not in hybrid.notes


@pytest.mark.slow
def test_what_is_lost_stays_lost_when_another_direction_is_lost():
    """A second column is lost behind the place of a first one that had been replaced: neither is finite."""
    parameters = {"n": 8, "coupling": 1 / 16, "topology": "ring"}
    frame = np.linalg.qr(np.random.default_rng(0).normal(size=(8, 8)))[0]  # in no invariant subspace
    hybrid, closed = (p.spectrum(t1=8.0, transient=0.0, frame=frame) for p in both(**parameters))
    assert_same(hybrid, closed)
    assert np.sum(np.isneginf(hybrid.exponents)) == 4


# States that are known.


PAIRS = [("leaky", -0.1), ("leaky", 0.1), ("xif", 0.1), ("qif", -0.1), ("qif", 0.1)]


@pytest.mark.parametrize(("model", "coupling"), PAIRS)
def test_the_reference_of_a_pair(model, coupling):
    """Over whole periods of the orbit, so that nothing is left over."""
    problem = zoo.integrate_and_fire(model=model, coupling=coupling, form="event_driven")
    spectrum = problem.spectrum(clock="jumps", transient=1000, t1=1000)
    per_time = np.asarray(spectrum.exponents * spectrum.jumps / spectrum.time)
    # Of "qif" neighbours have other periods: they separate like t, and exponents go to 0 like ln t/t.
    slack = 2e-11 if model != "qif" else math.log(1000) / float(spectrum.time)
    assert_allclose(per_time, problem.reference.exponents, atol=slack)
    assert spectrum.losses[1] == (1000 if np.isneginf(per_time[1]) else 0)
    if model == "qif":
        assert_allclose(np.sum(per_time), 0, atol=1e-4)


def test_the_pair_that_is_known_in_closed_form():
    """The quadratic equation of the docstring, for both kinds of linear neuron."""
    for model, slope, coupling in (("leaky", -1, -0.3), ("xif", 1, 0.15)):
        current = 1.7
        threshold, reset = 1 + slope * current, slope * current
        waiting = (coupling + slope * math.sqrt(coupling**2 + 4 * threshold * reset)) / 2
        period = slope * math.log(threshold / waiting)
        problem = zoo.integrate_and_fire(model=model, coupling=coupling, current=current)
        expected = 2 * slope + math.log(reset / threshold) / period
        assert_allclose(problem.reference.exponents, [0, expected], rtol=1e-13)


def test_an_anti_leaky_pair_too_strongly_excited_fires_together():
    assert zoo.integrate_and_fire(model="xif", coupling=0.18).reference
    problem = zoo.integrate_and_fire(model="xif", coupling=0.2, form="event_driven")
    assert problem.reference is None
    assert zoo.integrate_and_fire(model="xif", coupling=-0.1).reference is None
    assert problem.spectrum(clock="jumps", t1=10, transient=0).exponents[1] == -jnp.inf


def after_spikes(problem, count):
    """In the middle between two spikes, and the time between them."""
    system, args = problem.system, problem.args

    def fly_and_fire(_, x):
        dt, which = system.next_event(0.0, x, args)
        return system.jump(0.0, system.flow(dt, 0.0, x, args), args, which)

    x = jax.lax.fori_loop(0, count, fly_and_fire, problem.x0)
    dt, _ = system.next_event(0.0, x, args)
    return system.flow(dt / 2, 0.0, x, args), float(dt)


def test_the_splay_state_of_inhibited_leaky_neurons():
    """The multipliers of its whole period, n spikes: complex, so that a run's exponents turn for ever."""
    problem = zoo.integrate_and_fire(n=5, form="event_driven")
    x, interval = after_spikes(problem, 3000)
    whole = lh.tangent_map(problem.system, x, problem.args, t1=5 * interval)
    assert_allclose(whole.x, x, atol=1e-12)
    multipliers = np.abs(np.linalg.eigvals(whole.matrix))
    expected = np.exp(5 * interval * np.array(problem.reference.exponents))
    assert_allclose(np.sort(multipliers)[::-1], expected, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "current", "coupling"), [(3, 1.935, -0.4853), (6, 4.0, -0.2), (10, 1.423, -0.9807)])
def test_inhibited_leaky_neurons_end_in_the_splay_state(n, current, coupling):
    problem = zoo.integrate_and_fire(n=n, current=current, coupling=coupling, form="event_driven")
    spectrum = problem.spectrum(t1=300.0, transient=300.0, averaging="birkhoff")
    assert_allclose(spectrum.exponents, problem.reference.exponents, atol=2e-3)


@pytest.mark.slow
def test_excited_leaky_neurons_end_in_synchrony():
    problem = zoo.integrate_and_fire(n=5, coupling=0.1, form="event_driven")
    spectrum = problem.spectrum(clock="jumps", transient=1000, t1=100)
    assert_allclose(spectrum.exponents, problem.reference.exponents, atol=1e-12)
    assert np.asarray(spectrum.losses)[1:].tolist() == [100] * 4
    assert_allclose(spectrum.time, 100 * math.log(2), rtol=1e-12)


def test_no_splay_state_where_pulses_change_the_order():
    assert zoo.integrate_and_fire(n=3, coupling=-0.5).reference
    assert zoo.integrate_and_fire(n=3, coupling=-1.5).reference is None
    assert zoo.integrate_and_fire(n=3, coupling=0.0).reference is None


def test_quadratic_neurons_all_to_all_keep_their_cross_ratios():
    """Each spike moves the phases of all by one Möbius map of V (Watanabe & Strogatz)."""
    problem = zoo.integrate_and_fire(model="qif", n=4, coupling=-0.5, form="event_driven")

    def ratio(x):
        a, b, c, d = np.tan(np.asarray(x) / 2)
        return (a - c) * (b - d) / ((a - d) * (b - c))

    x, _ = after_spikes(problem, 101)
    assert np.max(np.abs(x - problem.x0)) > 1
    assert_allclose(ratio(x), ratio(problem.x0 + 0.1), rtol=1e-11)  # moved on, as infinity is no number


# Many neurons.


def strongly_diluted(model, n, strength):
    """About ten inputs each, all of one strength."""
    there = jax.random.bernoulli(jax.random.key(0), 10 / n, (n, n)) & ~jnp.eye(n, dtype=bool)
    coupling = jnp.where(there, strength, 0.0)
    current = 2.0 if model == "leaky" else 1.0
    return zoo.integrate_and_fire(model=model, n=n, coupling=coupling, current=current, form="event_driven")


@pytest.mark.parametrize("n", [50, pytest.param(200, marks=pytest.mark.slow)])
def test_inhibited_leaky_neurons_are_stable_though_irregular(n):
    """Stable chaos: next to the zero of the flow all exponents are negative (Zillmer, Livi, Politi & Torcini 2006)."""
    spectrum = strongly_diluted("leaky", n, -0.2).spectrum(t1=100.0, transient=20.0, k=2)
    assert spectrum.jumps > 20 * n
    assert abs(spectrum.exponents[0]) < 0.01
    assert spectrum.exponents[1] + 5 * spectrum.stderr[1] < 0
    assert not np.any(np.asarray(spectrum.losses))


@pytest.mark.parametrize("n", [50, pytest.param(200, marks=pytest.mark.slow)])
def test_inhibited_quadratic_neurons_are_chaotic(n):
    """Monteforte & Wolf, Phys. Rev. Lett. 105 (2010) 268104."""
    problem = strongly_diluted("qif", n, -1.0)
    spectrum = problem.spectrum(t1=200.0, transient=50.0, k=2)
    assert spectrum.stderr[0] < 0.06
    assert spectrum.exponents[0] > 0.3


# Numbers travel in args.


def test_networks_of_one_structure_are_one_system():
    def system(**parameters):
        return zoo.integrate_and_fire(**{"n": 4, "form": "event_driven"} | parameters).system

    assert system() is system(current=3.0, coupling=0.2)
    assert system(coupling=random_matrix(0, 4, 0.1, 1.0)) is system(coupling=random_matrix(1, 4, 0.1, 1.0))
    structures = [{}, {"topology": "ring"}, {"model": "qif"}, {"n": 5}, {"coupling": np.zeros((4, 4))}]
    assert len({id(system(**parameters)) for parameters in structures}) == len(structures)


def test_a_matrix_may_be_traced_and_is_described_by_its_shape():
    def after(matrix):
        problem = zoo.integrate_and_fire(n=2, coupling=matrix, form="event_driven")
        return problem.system.jump(0.0, jnp.array([1.0, 0.3]), problem.args, jnp.asarray(0, jnp.int32))[1]

    assert_allclose(jax.jacfwd(after)(jnp.zeros((2, 2))), [[0, 0], [1, 0]])
    assert "coupling=an array (2, 2)" in repr(zoo.integrate_and_fire(coupling=np.zeros((2, 2))))


# Sparse networks.


def dense(sparse, strengths):
    """The same network by its matrix, without a schedule."""
    n = sparse.parameters["n"]
    targets = random_targets(n, sparse.parameters["synapses"], sparse.parameters["seed"])
    matrix = np.zeros((n, n))
    for source, reached in enumerate(targets):
        matrix[reached, source] = strengths[source]
    parameters = {name: sparse.parameters[name] for name in ("n", "current", "model")}
    return zoo.integrate_and_fire(form="event_driven", coupling=matrix, **parameters)


@pytest.mark.slow_cases("one strength-qif-0.8", "one strength-leaky-2.5")
@pytest.mark.parametrize(("model", "current"), [("qif", 0.8), ("leaky", 2.5)])
@pytest.mark.parametrize("alike", [True, False], ids=["one strength", "a strength each"])
def test_a_sparse_network_is_the_dense_one_with_its_matrix(model, current, alike):
    """All exponents at a finite time, and the state."""
    n = 15
    strengths = np.full(n, -0.3) if alike else np.linspace(-0.1, -0.7, n)
    sparse = zoo.sparse_network(
        n=n, synapses=4, current=current, coupling=-0.3 if alike else strengths, model=model, seed=3
    )
    full = dense(sparse, strengths)
    kwargs = {"k": n, "t1": 300.0, "transient": 0.0, "clock": "jumps", "every": 5}
    found = sparse.spectrum(**kwargs)
    wanted = lh.lyapunov_spectrum(full.system, sparse.x0, full.args, **kwargs)
    assert found.status == wanted.status == lh.STATUS.ok
    assert_allclose(found.exponents, wanted.exponents, rtol=0, atol=1e-10)
    assert_allclose(found.x, wanted.x, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_a_chosen_interval_agrees_with_every_spike():
    """The interval between orthonormalisations adapts; with it 17 components a spike are judged by the frame."""
    sparse = zoo.sparse_network(n=60, synapses=20)
    adapted, each = (sparse.spectrum(k=5, t1=400, transient=0.0, clock="jumps", **how) for how in ({}, {"every": 1}))
    assert_allclose(adapted.exponents, each.exponents, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_balanced_networks_are_chaotic_or_stable_by_their_neurons():
    """Inhibited "qif" neurons have λ₁ > 0 (Monteforte & Wolf), "leaky" ones a zero and λ₂ < 0 (Jahnke et al.)."""
    chaotic = zoo.sparse_network(n=300, synapses=30).spectrum(k=2, t1=100.0)
    assert chaotic.exponents[0] > 10 * chaotic.stderr[0] > 0
    stable = zoo.sparse_network(n=300, synapses=30, current=5.0, model="leaky").spectrum(k=2, t1=100.0)
    assert abs(stable.exponents[0]) < 1e-3
    assert stable.exponents[1] < -10 * stable.stderr[1] < 0


@pytest.mark.parametrize("synapses", [1, 3, 9])
def test_targets_are_different_others(synapses):
    """Also where a neuron reaches all others."""
    targets = random_targets(10, synapses, 5)
    assert targets.shape == (10, synapses)
    for neuron, reached in enumerate(targets):
        assert len(set(reached) - {neuron}) == synapses
        assert set(reached) <= set(range(10))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"n": 2}, "n must be at least 3"),
        ({"n": 10, "synapses": 10}, "synapses must be from 1 to n - 1 = 9"),
        ({"model": "xif"}, "model must be"),
        ({"model": "leaky"}, "current must be above the threshold 1"),
        ({"current": -1.0}, "current must be"),
        ({"model": "leaky", "current": 2.0, "coupling": 0.1}, "coupling must be at most 0"),
        ({"coupling": np.nan}, "coupling must be finite"),
        ({"n": 60, "coupling": np.zeros(3)}, r"shape \(n,\) = \(60,\); got \(3,\)"),
    ],
)
def test_bad_parameters_of_a_sparse_network_are_refused(parameters, message):
    """Before anything is computed."""
    with pytest.raises(ValueError, match=message):
        zoo.sparse_network(**parameters)
