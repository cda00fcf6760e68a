"""The zoo: named problems with source and reference; and hard disks, whose events are known to 60 digits."""

import inspect
import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid import zoo
from lyaphybrid._jax.engines import compiled
from lyaphybrid.engine.evolvers.scheduled import predicting_anew
from lyaphybrid.systems.daes.semi_linear import degrees_of_freedom
from lyaphybrid.systems.event_driven import EventDriven
from lyaphybrid.systems.hybrid import Hybrid
from lyaphybrid.systems.smooth import Flow, Map
from lyaphybrid.zoo import problem as problem_module

VARIANTS = [
    *((name, {}) for name in zoo.names()),
    ("cat_map", {"form": "jumps"}),
    ("integrate_and_fire", {"form": "event_driven"}),
    ("integrate_and_fire", {"n": 5, "coupling": 0.1}),
    ("integrate_and_fire", {"n": 7, "form": "event_driven"}),
    ("integrate_and_fire", {"model": "xif", "coupling": 0.1}),
    ("integrate_and_fire", {"model": "qif", "topology": "ring", "form": "event_driven"}),
    ("kicked_ball", {"restitution": 0.5, "amplitude": 1.75}),
    ("grow_reset", {"q": 0}),
    ("impact_oscillator", {"omega": 2.0}),
    ("impact_oscillator", {"omega": 0.5, "gap": -0.5, "restitution": 0.3, "sticking": True}),
    ("hard_disks", {"density": 0.2}),
    ("hard_disks", {"n": 2, "density": 0.32, "aspect": 1}),
    ("sinai_billiard", {"radius": 0.2}),
    ("logistic_map", {"r": 2.5}),
    ("standard_map", {"K": 6.9}),
    ("friction_pendulum", {"beta": 0.3}),
    ("friction_pendulum", {"alpha": 0.5, "form": "autonomous"}),
    ("block_on_plate", {"alpha": 0.6}),
    ("stick_slip_belt", {"force": 0.5}),
    ("relay_feedback", {"form": "sliding"}),
    ("henon_heiles", {"y": 0.55}),
    ("fpu_beta", {"n": 16}),
    ("kepler", {"eccentricity": 0.0}),
    ("restricted_three_body", {"mu": 0.5, "jacobi": 3.0}),
    ("coupled_standard_maps", {"n": 2}),
    ("lorenz96", {"n": 4}),
    ("klein_gordon", {"n": 20, "seed": 3}),
    ("schroedinger_lattice", {"n": 20, "nonlinearity": 0.0}),
]
WITHOUT_REFERENCE = [
    ("sinai_billiard", {"field": 0.5}),
    ("lorentz_gas", {"field": 0.5}),
    ("stadium", {"field": 0.5}),
    ("wedge", {"angle": 1.1}),
]


def parametrize(cases):
    return pytest.mark.parametrize(("name", "parameters"), cases, ids=[f"{n}{p or ''}" for n, p in cases])


variants, all_variants = parametrize(VARIANTS), parametrize(VARIANTS + WITHOUT_REFERENCE)


def natively(function):
    """The function, compiled once for all numbers."""
    run = compiled()(function)
    return lambda *args: jax.tree.map(np.asarray, run(*jax.tree.map(np.asarray, args)))


def whole(problem):
    """The system as functions of the whole state, also where it has a schedule."""
    system = problem.system
    return predicting_anew(system, problem.x0.shape) if isinstance(system, EventDriven) else system


# Every entry.


@variants
def test_every_problem_is_complete(name, parameters):
    problem = zoo.get(name)(**parameters)
    n = problem.x0.shape[0]
    assert problem.name == name
    assert problem.x0.dtype == jnp.float64
    assert bool(jnp.all(jnp.isfinite(problem.x0)))
    assert re.search(r"doi:10\.\d{4}|Benjamin 1968|Dokl. Akad. Nauk", problem.source)
    assert parameters.items() <= problem.parameters.items()
    for text in (name, problem.source):
        assert text in repr(problem)
    reference = problem.reference
    if reference is None:
        assert "none for these parameters" in repr(problem)
        return
    assert reference.source in repr(problem)
    assert len(reference.exponents) == len(reference.stderr) == degrees_of_freedom(problem.system, n)
    assert list(reference.exponents) == sorted(reference.exponents, reverse=True)
    assert reference.exact == (not any(reference.stderr))
    assert reference.clock in ("time", "jumps")


@pytest.mark.parametrize("name", zoo.names())
def test_every_problem_is_documented(name):
    function = getattr(zoo, name)
    described = inspect.getdoc(function)
    names = inspect.signature(function).parameters
    assert all(re.search(rf"^ +{p}: ", described, re.MULTILINE) for p in names)
    assert all(f"{section}:" in described for section in ("Args", "Returns", "Source", "Example"))
    assert set(names) - {"key"} == set(function().parameters)


def functions_of(system):
    """(t, x, args) -> what all functions of the system return that should be like x, and the time to an event."""

    def of_events(t, x, args):
        dt, which = system.next_event(t, x, args)
        assert system.guard(t, x, args, which).shape == ()
        return [system.flow(dt, t, x, args), system.jump(t, x, args, which)], dt

    def of_hybrid(t, x, args):
        assert isinstance(system, Hybrid)
        found = [field(t, x, args) for field in system.fields or ()]
        for transition in system.transitions:
            which = ()
            if not transition.is_clock:
                guard = transition.guard(t, x, args)
                assert len(guard.shape) <= 1
                which = () if guard.shape == () else (jnp.asarray(1, jnp.int32),)
            if transition.reset is not None:
                found.append(transition.reset(t, x, args, *which))
        return found, jnp.inf

    if isinstance(system, EventDriven):
        return of_events
    if isinstance(system, Flow | Map):
        function = system.field if isinstance(system, Flow) else system.rule
        return lambda t, x, args: ([function(t, x, args)], jnp.inf)
    return of_hybrid


@all_variants
def test_functions_return_the_shape_of_the_state(name, parameters):
    problem = zoo.get(name)(**parameters)
    system, x = whole(problem), problem.x0
    shapes, dt = natively(functions_of(system))(0.1, x, problem.args)
    assert dt > 0
    assert all(y.shape == x.shape and y.dtype == x.dtype and np.all(np.isfinite(y)) for y in shapes)


@all_variants
def test_parameters_that_are_numbers_do_not_change_the_system(name, parameters):
    build = zoo.get(name)
    a = build(**parameters)
    moved = {k: v * 0.99 for k, v in a.parameters.items() if isinstance(v, float) and k != "diameter"}
    b = build(**{**parameters, **moved})
    assert a.system is b.system  # so a compiled function is found again
    assert a.mode == b.mode
    # Numbers as they are; arrays, such as the disorder of a lattice, travel in args too.
    assert all(type(v) is float or isinstance(v, np.ndarray) for v in jax.tree.leaves(b.args))
    assert jax.tree.structure(a.args) == jax.tree.structure(b.args)


def test_a_traced_parameter_reaches_args():
    def speed(rho):
        problem = zoo.lorenz63(rho=rho)
        assert problem.reference is None
        assert "traced" in repr(zoo.bouncing_ball(velocity=rho))
        return jnp.sum(problem.system.field(0.0, problem.x0, problem.args))

    values = jnp.array([20.0, 28.0])
    np.testing.assert_allclose(jax.vmap(jax.grad(speed))(values), 1.0)  # d/dρ of x(ρ − z) at x = 1


def test_the_energy_of_disks_may_be_traced():
    def total(energy):
        problem = zoo.hard_disks(kinetic_energy=energy)
        assert problem.reference is None
        return jnp.sum(problem.x0[8:] ** 2) / 2

    np.testing.assert_allclose(jax.vmap(jax.value_and_grad(total))(jnp.array([1.0, 4.0])), [[1, 4], [1, 1]])


def test_spectrum_hands_over_what_the_problem_says(monkeypatch):
    calls = []
    found = lh.lyapunov_spectrum(lh.Map(lambda n, x, args: 0.5 * x), [1.0], t1=10)
    monkeypatch.setattr(problem_module, "lyapunov_spectrum", lambda *a, **k: calls.append((a, k)) or found)
    problem = zoo.conewise_linear()
    assert problem.spectrum(transient=3.0, x0=[1.0, 2.0], k=1).name == "conewise_linear"
    (system, x0, args), keywords = calls[0]
    assert (system, x0, args) == (problem.system, [1.0, 2.0], problem.args)
    assert keywords == {
        "t1": problem.t1,
        "transient": 3.0,
        "clock": "time",
        "mode": "right",
        "method": None,
        "k": 1,
    }


# Bad names and parameters.


def test_unknown_names_list_the_valid_ones_nearest_first():
    with pytest.raises(ValueError, match=r"no 'hard_disc'.*first: hard_disks, .*lorenz63"):
        zoo.get("hard_disc")
    with pytest.raises(AttributeError, match=r"no 'rosler'.*first: rossler, "):
        _ = zoo.rosler
    assert all(name in str(pytest.raises(ValueError, zoo.get, "x").value) for name in zoo.names())


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: zoo.lorenz63(rh=1),
            r"no parameter 'rh'; the nearest is 'rho' of lorenz63\(sigma=10, rho=28, beta",
        ),
        (lambda: zoo.lorenz63(10), r"by name: lorenz63\(sigma=10"),
        (lambda: zoo.lorenz63(rho="28"), r"rho must be a finite real number; got '28'"),
        (lambda: zoo.lorenz63(rho=math.nan), r"rho must be a finite real number; got nan"),
        (lambda: zoo.lorenz63(rho=True), r"rho must be a finite real number; got True"),
        (lambda: zoo.lorenz63(rho=np.ones(2)), r"rho must be a finite real number; got array"),
        (lambda: jax.vmap(lambda r: zoo.lorenz63(rho=r).x0)(jnp.ones((2, 3))), r"rho .* shape \(3,\)"),
        (lambda: zoo.logistic_map(r=4.1), r"r must be in \[0, 4\].*; got 4.1"),
        (lambda: zoo.cat_map(form="flow"), r"form must be one of 'map', 'jumps'; got 'flow'"),
        (lambda: zoo.baker_map(p=1), r"p must be between 0 and 1; got 1.0"),
        (lambda: zoo.kaplan_yorke_map(alpha=1), r"alpha must be between −1 and 1"),
        (lambda: zoo.kaplan_yorke_map(slope=1), r"slope must be above 1"),
        (lambda: zoo.bouncing_ball(restitution=1), r"restitution must be between 0 and 1"),
        (lambda: zoo.bouncing_ball(gravity=-9.81), r"gravity must be positive; got -9.81"),
        (lambda: zoo.kicked_ball(omega=0), r"omega must be positive"),
        (lambda: zoo.zaslavsky(drive=5), r"drive must be above \|kick\| = 8; got 5"),
        (lambda: zoo.impact_oscillator(restitution=0), r"restitution must be in \(0, 1\]"),
        (lambda: zoo.integrate_and_fire(n=1), r"n must be at least 2; got 1"),
        (lambda: zoo.integrate_and_fire(n=2.0), r"n must be a whole number; got 2.0"),
        (lambda: zoo.integrate_and_fire(current=1), r"current must be above the threshold 1"),
        (lambda: zoo.integrate_and_fire(model="xif", current=0), r"current must be positive; got 0"),
        (lambda: zoo.integrate_and_fire(model="lif"), r"model must be one of 'leaky', 'xif', 'qif'; got 'lif'"),
        (lambda: zoo.integrate_and_fire(topology="line"), r"topology must be one of 'all', 'ring'; got 'line'"),
        (lambda: zoo.integrate_and_fire(coupling="all"), r"coupling must be a finite real number; got 'all'"),
        (lambda: zoo.integrate_and_fire(current=np.ones(2)), r"current must be a finite real number; got array"),
        (lambda: zoo.integrate_and_fire(coupling=np.zeros((3, 3))), r"\(n, n\) = \(2, 2\); got \(3, 3\).*as n"),
        (lambda: zoo.integrate_and_fire(coupling=np.eye(2)), r"coupling must be 0 on the diagonal.*got array"),
        (lambda: zoo.integrate_and_fire(coupling=np.full((2, 2), np.nan)), r"coupling must be finite"),
        (
            lambda: zoo.integrate_and_fire(coupling=np.zeros((2, 2)), topology="ring"),
            r"topology must be \"all\" where coupling is a matrix.*got 'ring'",
        ),
        (lambda: zoo.conewise_linear(omega_left=-1), r"omega_left must be positive"),
        (lambda: zoo.beta_clock(rate=0), r"rate must be positive"),
        (lambda: zoo.skew_tent_roof(peak=0), r"peak must be between 0 and 1"),
        (lambda: zoo.grow_reset(q=0.9), r"q must be at least 0 and below e\^−growth = 0.7788"),
        (lambda: zoo.hard_disks(n=1), r"n must be at least 2"),
        (lambda: zoo.hard_disks(density=1.2), r"4 disks .* do not fit .* must be below 1.155"),
        (lambda: zoo.hard_disks(kinetic_energy=0), r"kinetic_energy must be positive"),
        (
            lambda: jax.jit(lambda d: zoo.hard_disks(density=d).x0)(0.5),
            r"density, aspect and diameter decide",
        ),
        (lambda: zoo.sinai_billiard(radius=0.5), r"radius must be between 0 and 1/2"),
        (lambda: zoo.sinai_billiard(field=math.inf), r"field must be a finite real number"),
        (lambda: zoo.lorentz_gas(gap=0), r"gap must be positive; got 0"),
        (lambda: zoo.stadium(side=-1), r"side must be positive; got -1"),
        (lambda: zoo.stadium(radius=0), r"radius must be positive; got 0"),
        (lambda: zoo.ellipse(b=0), r"b must be positive; got 0"),
        (lambda: zoo.wedge(angle=1.6), r"angle must be between 0 and π/2; got 1.6"),
        (lambda: zoo.lorenz96(n=3), r"n must be at least 4; got 3"),
        (lambda: zoo.coupled_standard_maps(n=1), r"n must be at least 2; got 1"),
        (lambda: zoo.henon_heiles(energy=0.01, y=0.5), r"energy must be large enough for the start"),
        (lambda: zoo.hamiltonian_3d(energy=0), r"energy must be large enough for the start"),
        (lambda: zoo.fpu_beta(n=1), r"n must be at least 2; got 1"),
        (lambda: zoo.fpu_alpha(n=1), r"n must be at least 2; got 1"),
        (lambda: zoo.fpu_alpha(alpha=0), r"alpha must be positive; got 0"),
        (lambda: zoo.double_pendulum(gravity=0), r"gravity must be positive; got 0"),
        (lambda: zoo.kepler(eccentricity=1), r"eccentricity must be at least 0 and below 1; got 1"),
        (lambda: zoo.kepler(eccentricity=-0.1), r"eccentricity must be at least 0 and below 1; got -0.1"),
        (lambda: zoo.restricted_three_body(mu=0.6), r"mu must be above 0 and at most 1/2; got 0.6"),
        (lambda: zoo.restricted_three_body(mu=0.25, x=0.75), r"x must be at a distance from both bodies; got 0.0"),
        (lambda: zoo.restricted_three_body(mu=0.25, x=-0.25), r"x must be at a distance from both bodies; got 0.0"),
        (lambda: zoo.restricted_three_body(jacobi=9), r"jacobi must be small enough for the start"),
    ],
)
def test_bad_parameters_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


# References are those of the data, which this library did not compute.


def test_references_of_maps_and_flows(maps_and_flows):
    for problem, key in [
        (zoo.henon_map(), "gt.henon"),
        (zoo.standard_map(), "gt.standard.K6.9115"),
        (zoo.standard_map(K=6.9), "gt.standard.K6.9"),
        (zoo.lorenz63(), "gt.lorenz63"),
        (zoo.logistic_map(), "gt.logistic4"),
        (zoo.kaplan_yorke_map(), "gt.kaplan_yorke"),
        (zoo.cat_map(), "gt.cat"),
    ]:
        known = maps_and_flows[key]
        assert problem.reference.exponents == pytest.approx(known["value"], abs=1e-9), key
        assert max(problem.reference.stderr) == pytest.approx(np.max(known["se"])), key


def test_references_of_exact_cases(event_driven):
    exact = event_driven["exact"]
    for problem, key, name in [
        (zoo.beta_clock(), "beta_clock", "exponents"),
        (zoo.skew_tent_roof(), "skew_tent_roof", "exponents"),
        (zoo.grow_reset(q=0), "grow_reset_rank_loss", "exponents"),
        (zoo.integrate_and_fire(), "LIF_pair_inhibitory", "exponents"),
        (zoo.bouncing_ball(), "zeno_bouncing_ball", "exponents_per_jump"),
        (zoo.cat_map(form="jumps"), "cat_map_jumps_only", "exponents_per_jump"),
        (zoo.kicked_ball(), "bouncing_ball_period1", "exponents"),
    ]:
        expected = sorted((float(e) for e in exact[key][name]), reverse=True)
        expected = expected[1:] if key == "bouncing_ball_period1" else expected  # time is not a variable here
        assert problem.reference.exponents == pytest.approx(expected, rel=1e-14, abs=1e-15), key
        assert problem.reference.exact
        assert problem.clock == ("jumps" if name.endswith("jump") else "time")


def test_references_of_impacts(event_driven, nonsmooth):
    for problem, known in [
        (zoo.impact_oscillator(), event_driven["computed"]["imp"]),
        (zoo.zaslavsky(), event_driven["computed"]["zas"]),
    ]:
        without_time = [known["lam_time"][0], known["lam_time"][2]]
        assert problem.reference.exponents == pytest.approx(without_time)
        errors = np.maximum(known["se_block"], known["se_seeds"])[[0, 2]]
        assert problem.reference.stderr == pytest.approx(errors, rel=0.02)
    known = nonsmooth["impact periodic"]
    assert zoo.impact_oscillator(omega=2).reference.exponents == pytest.approx(known["exponents"])
    chaos = zoo.impact_oscillator().reference
    other = nonsmooth["impact chaos"]  # the same system by another program
    assert np.all(np.abs(np.subtract(chaos.exponents, other["exponents"])) < 3 * np.hypot(chaos.stderr, other["se"]))


def test_references_of_disks_and_billiards(event_driven):
    for density in (0.7, 0.2):
        key = "N4_rho0.7_TableI" if density == 0.7 else "N4_rho0.2"
        known, reference = event_driven["hard_disks"][key], zoo.hard_disks(density=density).reference
        assert reference.exponents[:5] == pytest.approx(known["lambda_positive"])
        assert reference.stderr[:5] == pytest.approx(known["se"])
        assert reference.exponents[5:11] == (0,) * 6
        np.testing.assert_allclose(reference.exponents, -np.flip(reference.exponents))
    for radius in (0.4, 0.2):
        known = event_driven["billiards"]["sq", radius]
        reference = zoo.sinai_billiard(radius=radius).reference
        assert (reference.exponents[0], reference.stderr[0]) == (known["lam_time_best"], known["se_best"])
        assert zoo.sinai_billiard(radius=radius, field=0.1).reference is None
    assert zoo.stadium(side=2).reference is zoo.stadium(radius=2).reference is zoo.wedge(angle=1).reference is None
    pair, known = (
        zoo.hard_disks(n=2, density=0.32, aspect=1).reference,
        event_driven["hard_disks"]["N2_square_L2.5"],
    )
    assert abs(pair.exponents[0] - known["lambda_positive"][0]) < 3 * known["se"][0]


def test_the_reference_of_disks_has_the_dimension_of_a_rate():
    plain, scaled = zoo.hard_disks(), zoo.hard_disks(density=0.7 / 9, diameter=3, mass=2, kinetic_energy=32)
    np.testing.assert_allclose(scaled.reference.exponents, np.multiply(plain.reference.exponents, 2 / 3))
    assert zoo.hard_disks(density=0.6).reference is None


def test_references_go_with_the_parameters():
    assert zoo.lorenz63(rho=27).reference is None
    assert zoo.kicked_ball(amplitude=3, restitution=0.5).reference is None
    assert zoo.kicked_ball(amplitude=0.1).reference is None  # no bounce a period
    assert zoo.impact_oscillator(gap=0.1).reference is None
    fast = zoo.kicked_ball(omega=2.0, gravity=4.0)  # the same in half the time
    np.testing.assert_allclose(fast.reference.exponents, 2 * np.array(zoo.kicked_ball().reference.exponents))


def test_the_kicked_ball_starts_on_its_orbit(event_driven):
    phase = 1.214222261943226  # of the bounce: reference/event_driven.json
    assert "tau0=acos((1-al) pi/(1+al))=1.214222261943226" in event_driven["exact"]["bouncing_ball_period1"]["ic"]
    x, v = zoo.kicked_ball().x0
    np.testing.assert_allclose(x + v * phase - phase**2 / 2, math.sin(phase), atol=1e-14)
    np.testing.assert_allclose(v - phase, -math.pi, atol=1e-14)


# Neurons.


@pytest.mark.slow
def test_integrate_and_fire_in_closed_form_is_the_hybrid_one():
    hybrid, closed = zoo.integrate_and_fire(), zoo.integrate_and_fire(form="event_driven")
    transition, field, args = hybrid.system.transitions[0], hybrid.system.fields[0], hybrid.args
    x = np.asarray(hybrid.x0)
    for _ in range(6):
        dt, which = closed.system.next_event(0.0, jnp.asarray(x), args)
        h, y = float(dt) / 100, x
        for _ in range(100):  # RK4: the leak is linear
            k1 = field(0.0, y, args)
            k2 = field(0.0, y + h / 2 * k1, args)
            k3 = field(0.0, y + h / 2 * k2, args)
            k4 = field(0.0, y + h * k3, args)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        landed = closed.system.flow(dt, 0.0, x, args)
        np.testing.assert_allclose(landed, y, atol=1e-11)
        guards = transition.guard(0.0, landed, args)
        assert abs(guards[which]) < 1e-15 < np.delete(guards, which)
        np.testing.assert_allclose(closed.system.guard(0.0, landed, args, which), guards[which])
        x = np.asarray(transition.reset(0.0, landed, args, which))
        np.testing.assert_array_equal(x, closed.system.jump(0.0, landed, args, which))
        assert x[which] == 0

    def fire(_, x):
        dt, which = closed.system.next_event(0.0, x, args)
        return closed.system.jump(0.0, closed.system.flow(dt, 0.0, x, args), args, which)

    x = natively(lambda x: jax.lax.fori_loop(0, 500, fire, x))(x)
    dt, _ = closed.system.next_event(0.0, x, args)
    np.testing.assert_allclose(float(dt), 0.3819215677837863, rtol=1e-12)  # between firings, antiphase


def test_many_neurons():
    problem = zoo.integrate_and_fire(n=7, topology="ring")
    assert problem.reference is None
    assert len(set(np.asarray(problem.x0))) == 7
    assert problem.system.transitions[0].guard(0.0, problem.x0, problem.args).shape == (7,)


# Hard disks.


def functions(system):
    return [natively(one) for one in (system.next_event, system.flow, system.jump, system.guard)]


@pytest.fixture(scope="module")
def sixty_digits(event_driven):
    case = event_driven["hard_disks"]["N4_rho0.7_short_time_60digit"]
    problem = zoo.hard_disks()
    args = problem.args | {"width": float(case["Lx"]), "height": float(case["Ly"])}
    assert args == pytest.approx(problem.args, rel=1e-15)
    return whole(problem), np.array(case["ic"]), args, case


def energy(x, args):
    return float(jnp.sum(x[x.shape[0] // 2 :] ** 2)) / 2 / args["mass"]


def test_hard_disks_meet_as_60_digits_say(sixty_digits):
    system, x, args, case = sixty_digits
    next_event, flow, jump, guard = functions(system)
    t, start, before = 0.0, x, energy(x, args)
    for expected, first, second in case["events"][:30]:
        while True:
            dt, which = next_event(t, x, args)
            x, t = flow(dt, t, x, args), t + float(dt)
            if which >= 0:
                break
        assert divmod(int(which), 4) == (first, second)
        assert abs(t - float(expected)) < (1e-8 if t < 1 else 1e-7)
        assert abs(guard(t, x, args, which)) < 1e-14
        x = jump(t, x, args, which)
        assert abs(energy(x, args) - before) < 1e-13
        np.testing.assert_allclose(
            np.sum(x[8:].reshape(4, 2), axis=0), np.sum(start[8:].reshape(4, 2), axis=0), atol=1e-14
        )


@pytest.mark.slow
@pytest.mark.parametrize("until", ["t=0.1", "t=1.0"])
def test_the_derivative_through_the_events_is_the_60_digit_matrix(sixty_digits, until):
    """AD through `next_event` itself: flow, jump and prediction are right to first order."""
    system, x, args, case = sixty_digits
    end, known = float(until[2:]), case[until]

    def run(x):
        def body(carry):
            x, left = carry
            dt, which = system.next_event(0.0, x, args)
            return system.jump(0.0, system.flow(dt, 0.0, x, args), args, which), left - dt

        def early(carry):
            return system.next_event(0.0, carry[0], args)[0] < carry[1]

        x, left = jax.lax.while_loop(early, body, (x, jnp.asarray(end)))
        return system.flow(left, 0.0, x, args)

    x = jnp.asarray(x)
    end_state = np.array([float(v) for v in known["q"] + known["p"]])
    found, jacobian = natively(lambda x: (run(x), jax.jacfwd(run)(x)))(x)
    box = np.array([args["width"], args["height"]])
    shift = (found - end_state)[:8].reshape(4, 2) / box
    np.testing.assert_allclose(shift, np.round(shift), atol=1e-10)  # the same up to whole boxes
    np.testing.assert_allclose(found[8:], end_state[8:], atol=1e-10)
    matrix = np.array([float(v) for v in known["M_row_major"]]).reshape(16, 16)
    np.testing.assert_allclose(jacobian, matrix, atol=1e-9 * np.max(np.abs(matrix)))


@pytest.mark.slow
def test_the_guard_gives_the_derivative_of_the_time(sixty_digits):
    system, x, args, _ = sixty_digits

    @natively
    def derivatives(x):
        dt, which = system.next_event(0.0, x, args)
        predicted = jax.grad(lambda x: system.next_event(0.0, x, args)[0])(x)

        def height(dt, x):
            return system.guard(dt, system.flow(dt, 0.0, x, args), args, which)

        return predicted, *jax.grad(height, argnums=(0, 1))(dt, x)

    predicted, rate, gradient = derivatives(x)
    assert rate < 0
    np.testing.assert_allclose(-gradient / rate, predicted, atol=1e-12)


def brute_force(x, n, args, images=40):
    """The earliest contact over many images, without any shortcut: (t, first, second)."""
    q, p = np.asarray(x)[: 2 * n].reshape(n, 2), np.asarray(x)[2 * n :].reshape(n, 2)
    far = np.arange(-images, images + 1)
    shifts = np.stack(np.meshgrid(far * args["width"], far * args["height"]), axis=-1).reshape(-1, 2)
    best = (np.inf, -1, -1)
    for k in range(n):
        for m in range(k + 1, n):
            d, v = q[m] - q[k] + shifts, (p[m] - p[k]) / args["mass"]
            b, c = d @ v, np.sum(d * d, axis=1) - args["diameter"] ** 2
            meets = (b < 0) & (b * b - v @ v * c > 0)
            if meets.any():
                t = np.min((-b - np.sqrt(np.where(meets, b * b - v @ v * c, 0)))[meets] / (v @ v))
                best = min(best, (t, k, m))
    # Along a corridor a flight may be longer: what meets early is met in a near image.
    return best if best[1] >= 0 else brute_force(x, n, args, 4 * images)


@pytest.mark.slow_cases("parameters5", "parameters2", "parameters4")
@pytest.mark.parametrize(
    "parameters",
    [
        {"n": 2, "density": 0.7},  # sides below two diameters
        {"n": 2, "density": 0.02, "mass": 2.0},
        {"n": 3, "density": 0.15, "diameter": 0.5},
        {"n": 4, "density": 0.7},
        {"n": 5, "density": 0.1, "aspect": 3.0},
        {"n": 9, "density": 0.3},
    ],
)
def test_no_contact_is_missed_through_any_image(parameters):
    problem = zoo.hard_disks(**parameters, key=jax.random.key(7))
    n, args, x, t = parameters["n"], problem.args, problem.x0, 0.0
    next_event, flow, jump, guard = functions(whole(problem))
    box = jnp.tile(jnp.array([args["width"], args["height"]]), n)
    before, looks = energy(x, args), 0
    for _ in range(60):
        expected, first, second = brute_force(x, n, args)
        flown, which = 0.0, -1
        while which < 0:
            dt, which = next_event(t, x, args)
            t, x, flown = t + float(dt), flow(dt, t, x, args), flown + float(dt)
            looks += int(which < 0)
        assert divmod(int(which), n) == (first, second)
        np.testing.assert_allclose(flown, expected, rtol=1e-9, atol=1e-11)
        assert abs(guard(t, x, args, which)) < 1e-11
        # A dilute pair goes dozens of boxes away: brought back, for a jump rounds like the positions.
        x = jump(t, jnp.concatenate([jnp.mod(x[: 2 * n], box), x[2 * n :]]), args, which)
    np.testing.assert_allclose(energy(x, args), before, rtol=1e-12)
    assert looks > 0 or parameters["density"] > 0.2


@pytest.mark.slow
def test_looking_again_changes_nothing():
    problem = zoo.hard_disks(n=2, density=0.02)
    system, x, args = whole(problem), problem.x0, problem.args
    dt, which = system.next_event(3.0, x, args)
    assert which < 0
    np.testing.assert_allclose(float(dt), (1.5 * args["width"] - 1) / float(jnp.linalg.norm(x[6:] - x[4:6])))
    np.testing.assert_array_equal(system.jump(3.0, x, args, which), x)

    @natively
    def derivatives(t, x):
        jacobian = jax.jacfwd(lambda x: system.jump(t, x, args, which))(x)
        return jacobian, *jax.grad(lambda t, x: system.guard(t, x, args, which), argnums=(0, 1))(t, x)

    jacobian, rate, gradient = derivatives(3.0, x)
    np.testing.assert_array_equal(jacobian, np.eye(8))
    assert rate == -1  # so that S = I, not 0/0
    assert not gradient.any()


@pytest.mark.parametrize(
    "parameters", [{}, {"n": 7, "density": 0.5}, {"n": 64}, {"n": 2, "aspect": 2.0, "density": 0.3}]
)
def test_disks_start_apart_and_at_rest_together(parameters):
    problem = zoo.hard_disks(**parameters, kinetic_energy=3.0, mass=0.5, key=jax.random.key(3))
    n, args = problem.parameters["n"], problem.args
    q, p = np.asarray(problem.x0).reshape(2, n, 2)
    box = np.array([args["width"], args["height"]])
    np.testing.assert_allclose(n / np.prod(box), problem.parameters["density"])
    np.testing.assert_allclose(box[0] / box[1], problem.parameters["aspect"])
    d = q[:, None] - q[None, :]
    d = d - box * np.round(d / box)
    assert np.min(np.linalg.norm(d, axis=-1) + 9 * np.eye(n)) > args["diameter"]
    np.testing.assert_allclose(energy(problem.x0, args), 3.0)
    np.testing.assert_allclose(np.sum(p, axis=0), 0, atol=1e-14)
    assert np.any(problem.x0 != zoo.hard_disks(**parameters, kinetic_energy=3.0, mass=0.5).x0)


def test_four_disks_start_where_the_reference_does(sixty_digits):
    _, x, _, _ = sixty_digits
    np.testing.assert_allclose(zoo.hard_disks().x0[:8], x[:8], rtol=1e-15)


# The Sinai billiard.


def test_no_scatterer_is_missed():
    problem = zoo.sinai_billiard(radius=0.2)  # corridors are open: long flights
    next_event, flow, jump, guard = functions(whole(problem))
    args, x, flights = problem.args, problem.x0, []
    far = np.arange(-40, 41)
    corners = np.stack(np.meshgrid(far, far), axis=-1).reshape(-1, 2)
    for _ in range(300):
        q, v = np.asarray(x[:2]), np.asarray(x[2:])
        d = q - (corners + np.round(q))
        b, c = d @ v, np.sum(d * d, axis=1) - 0.04
        meets = (b < 0) & (b * b - c > 0)
        expected = np.min(-b[meets] - np.sqrt(b[meets] ** 2 - c[meets]))
        flown, which = 0.0, -1
        while which < 0:
            dt, which = next_event(0.0, x, args)
            x, flown = flow(dt, 0.0, x, args), flown + float(dt)
        np.testing.assert_allclose(flown, expected, rtol=1e-9)
        assert abs(guard(0.0, x, args, which)) < 1e-12
        x = jump(0.0, x, args, which)
        flights.append(flown)
    np.testing.assert_allclose(float(jnp.linalg.norm(x[2:])), 1.0, rtol=1e-12)
    assert max(flights) > 5
    free_path = (1 - math.pi * 0.04) / 0.4  # π area / perimeter
    assert abs(np.mean(flights) - free_path) < 5 * np.std(flights) / math.sqrt(len(flights))


@pytest.mark.slow
def test_two_disks_are_a_sinai_billiard():
    disks = zoo.hard_disks(n=2, density=0.32, aspect=1)
    pair, point = whole(disks), zoo.sinai_billiard().system
    side, x = disks.args["width"], disks.x0
    assert disks.args["diameter"] / side == pytest.approx(0.4)
    relative, speed = (
        jnp.concatenate([x[2:4] - x[:2], x[6:] - x[4:6]]),
        float(jnp.linalg.norm(x[6:] - x[4:6])),
    )
    y = jnp.concatenate([relative[:2] / side, relative[2:] / speed])
    radius = {"radius": disks.args["diameter"] / side}
    next_event, flow, jump, _ = functions(pair)
    next_of_point, flow_of_point, jump_of_point, _ = functions(point)
    for _ in range(12):
        dt, which = next_event(0.0, x, disks.args)
        ds, what = next_of_point(0.0, y, radius)
        np.testing.assert_allclose(float(dt) * speed / side, float(ds), rtol=1e-8)
        assert (which >= 0) == (what >= 0)
        x = jump(0.0, flow(dt, 0.0, x, disks.args), disks.args, which)
        y = jump_of_point(0.0, flow_of_point(ds, 0.0, y, radius), radius, what)
