"""What lowering knows of a program before it writes code: how long the code will be, and where values are used."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from lyaphybrid import native
from lyaphybrid.native.lowering import costs
from lyaphybrid.native.lowering.jax_versions import scan_of
from lyaphybrid.native.lowering.lowering import CALLS, ENTRYWISE
from lyaphybrid.native.lowering.uses import uses_of

X, MANY = np.ones(5), np.ones(50)


def program(function, *operands):
    return jax.make_jaxpr(function)(*operands).jaxpr


def count(function, *operands, small=16):
    return costs.instructions(program(function, *operands), small)


# --- costs -----------------------------------------------------------------------------------------------------------


def test_instructions_of_equations():
    """One for each entry, six for each equation that becomes part of a loop over memory."""
    assert count(lambda x: jnp.sin(x) * x, X) == 10
    assert count(lambda x: jnp.sin(x) * x, np.ones(16)) == 32
    assert count(lambda x: jnp.sin(x) * x, np.ones(17)) == 12
    assert count(lambda x: lax.rev(x, (0,)), X) == 0
    assert count(lambda x: lax.slice(x, (1,), (3,)), X) == 0
    assert count(lambda x: lax.reduce_sum_p.bind(x, axes=(0,), **EXTRA), X) == 5
    assert count(lambda x: lax.reduce_sum_p.bind(x, axes=(0,), **EXTRA), MANY) == 6
    assert count(lambda x: lax.cumsum(x), X) == 5
    assert count(lambda x, y: lax.dot(x, y), np.ones((2, 5)), np.ones((5, 3))) == 2 * 6 * 5
    assert count(lambda x, y: lax.dot(x, y), np.ones((5, 5)), np.ones((5, 5))) == 6
    assert count(lambda x, i: lax.dynamic_slice(x, (i,), (2,)), X, 1) - count(lambda i: i < 0, 1) <= 2 * 5 + 3
    assert count(lambda x, y: lax.sort([x, y], num_keys=1), X, X) == 4 * 2 * 5**2


EXTRA = {"out_sharding": None} if "out_sharding" in str(jax.make_jaxpr(lambda x: x.sum())(X)) else {}


@pytest.mark.parametrize(("length", "small", "each"), [(5, 16, 10), (5, 5, 10), (17, 16, 6), (5, 4, 6)])
def test_instructions_that_index_at_run_time(length, small, each):
    """A slice at an index that is not known: of entries each is compared; from memory it is one of three lines."""
    equation = [e for e in program(lambda x, i: lax.dynamic_slice(x, (i,), (2,)), np.ones(length), 1).eqns]
    assert costs._of_equation(equation[-1], small) == each


def test_instructions_that_change_entries():
    put = program(lambda x, y, i: lax.dynamic_update_slice(x, y, (i,)), X, np.ones(2), 1).eqns[-1]
    assert costs._of_equation(put, 16) == 2 * 5 * 2
    assert costs._of_equation(put, 5) == 2 * 5 * 2
    scatter = program(lambda x, y: x.at[np.array([1, 3])].set(y), X, np.ones(2)).eqns[-1]
    assert scatter.primitive.name == "scatter"
    assert costs._of_equation(scatter, 16) == 2 * 5 * 2
    assert costs._of_equation(put, 4) == 6


@pytest.mark.parametrize("name", ["add", "multiply", "min", "max"])
def test_a_scatter_that_adds_costs_as_much_as_one_that_sets(name):
    """Its parameters hold a program, which is the operation of its name and no call."""
    changed = program(lambda x, y: getattr(x.at[np.array([1, 3])], name)(y), X, np.ones(2)).eqns[-1]
    assert changed.primitive.name.startswith("scatter")
    assert costs._of_equation(changed, 16) == 2 * 5 * 2
    assert costs._of_equation(changed, 4) == 6
    assert not costs.worth_a_jump(program(lambda x: x.at[0].add(x[1]), X))
    several = lambda x: lax.cond(x[0] > 0, lambda x: x.at[np.array([1, 3])].add(x[:2]), lambda x: x, x)  # noqa: E731
    assert costs.apart(program(several, X)) == 0


def scan(length, n=5, work=1):
    """A scan whose body has `work` equations of n entries."""

    def body(carry, x):
        for _ in range(work):
            carry = carry * x
        return carry, None

    return lambda x: lax.scan(body, x, jnp.ones(length))[0]


def test_instructions_of_a_scan():
    """All turns of a short one, and what it returns; one turn of a long one, or of one with a long body."""
    for length, work, turns in ((8, 1, 8), (9, 1, 1), (8, 10, 8), (8, 11, 1)):  # 8 · 10 · 5 = 400 instructions
        assert count(scan(length, work=work), X) == turns * work * 5 + 5


def test_turns_that_are_written_out():
    def turns(function, *operands, small=200):
        equation = program(function, *operands).eqns[-1]
        scan = scan_of(equation)
        avals = [atom.aval for atom in (*equation.invars[scan.consts + scan.carry :], *equation.outvars)]
        return costs.turns_written_out(small, scan, avals)

    assert turns(scan(100, work=10), X) == 8  # the first eight …
    assert turns(scan(100, work=11), X) == 0  # … if they are short
    assert turns(scan(3, work=26), X) == 8  # 3 · 26 · 5 = 390
    assert turns(scan(3, work=27), X) == 0
    assert turns(scan(1, work=400), np.ones(1)) == 8
    assert turns(scan(1, work=401), np.ones(1)) == 0
    records = lambda x: lax.scan(lambda c, x: (c * x, c), x, jnp.ones(8))[1]  # noqa: E731  (8, 5), not entries
    assert turns(records, X, small=16) == 8
    many = lambda x: lax.scan(lambda c, x: (scan(1, work=50)(c) * x, c), x, jnp.ones(8))[1]  # noqa: E731
    assert turns(many, X) == 0
    assert turns(many, X, small=16) == 8  # more is written out where arrays in memory are indexed


def test_a_plan_takes_fewer_entries_where_an_index_is_known_late():
    known = [costs.plan(program(lambda x: x * 2, np.ones(n))).small for n in (5, 9, 10, 50)]
    assert known == [16, 16, 8, 16]  # 9 instructions are 3/2 of the 6 of a loop
    assert costs.plan(program(lambda x, i: lax.dynamic_slice(x, (i,), (6,)), np.ones(8), 1)).small == 4

    def long(x):
        for _ in range(2400):
            x = x * 1.5
        return x

    assert costs.plan(program(long, X)).scattered  # 12000 instructions
    assert not costs.plan(program(lambda x: long(x) + 1, X)).scattered


@pytest.mark.parametrize(("length", "long"), [(999, False), (1000, True)])
def test_a_scan_is_long_from_a_thousand_turns_on(length, long):
    assert costs.runs_long(program(scan(length), X)) == long


def test_branches_that_lanes_do_not_share():
    """Of so many equations or more a branch is jumped over; what is seldom run does not count."""

    def branch(work):
        def long(x):
            for _ in range(work):
                x = x * 1.5
            return x

        return long

    def part(work, rest=0, wrap=lambda f: f):
        def function(x):
            return wrap(lambda x: lax.cond(x[0] > 0, branch(work), lambda x: x, branch(rest)(x)))(x)

        return costs.apart(program(function, X))

    assert part(19) == 0
    assert 0.9 < part(20) <= 1
    assert abs(part(100, rest=100) - 0.5) < 0.02
    assert abs(part(100, rest=300) - 0.25) < 0.01
    assert part(100, rest=100, wrap=native.seldom) == 0
    sixteen = lambda x, y: lax.cond(y > 0, branch(25), lambda x: x, x).sum() + branch(84)(y)  # noqa: E731
    assert abs(costs.apart(program(sixteen, np.ones(16), 1.0)) - 400 / (400 + 16 + 84)) < 0.01  # as entries, and a sum
    assert costs.apart(program(lambda x: x, X)) == 0
    nested = lambda x: lax.cond(x[0] > 0, jax.jit(branch(50)), lambda x: x, x)  # noqa: E731
    assert costs.worth_a_jump(program(jax.jit(branch(19)), X))  # the call counts, too
    assert not costs.worth_a_jump(program(branch(19), X))
    assert costs.apart(program(nested, X)) > 0.9


# --- uses ------------------------------------------------------------------------------------------------------------


def uses(function, *operands):
    jaxpr = program(function, *operands)
    return jaxpr, uses_of(jaxpr, ENTRYWISE, CALLS, {})


def test_where_values_are_used_last():
    def function(x, y):
        a = jnp.sin(x)
        b = a * y
        jnp.cos(y)  # not used
        return b + a, x

    jaxpr, found = uses(function, MANY, MANY)
    x, y = jaxpr.invars
    a, b, unused, _ = (eqn.outvars[0] for eqn in jaxpr.eqns)
    assert found.last == {x: 4, y: 1, a: 3, b: 3, jaxpr.outvars[0]: 4}
    assert unused not in found.last


@pytest.mark.parametrize(
    ("function", "apart"),
    [
        (lambda x: jnp.sin(x) * x, False),
        (lambda x: (x * 2, x.sum()), True),  # two loops
        (lambda x: (jnp.sin(x) * 2, jnp.sin(x).sum()), False),  # one that computes the sine, of which there is one
        (lambda x: jnp.sin(x) + 1, False),
    ],
)
def test_values_that_are_used_in_one_loop_need_no_memory(function, apart):
    def shared(x):
        y = jnp.exp(x)
        return function(y)

    jaxpr, found = uses(shared, MANY)
    assert (jaxpr.eqns[0].outvars[0] in found.apart) == apart


def test_roots_of_operands():
    """The last loop that a value goes into; a result of the program is a root, and so is what is not entrywise."""

    def function(x, y, z):
        return jnp.sin(x) * y, z.sum(), y[::-1]

    jaxpr, found = uses(function, MANY, MANY, MANY)
    places = {eqn.primitive.name: place for place, eqn in enumerate(jaxpr.eqns)}
    assert found.roots[0] == {("result", 0)}
    assert found.roots[1] == {("result", 0), (places["rev"], "rev")}
    assert found.roots[2] == {(places["reduce_sum"], "reduce_sum")}
    assert uses(lambda x, y: x, MANY, MANY)[1].roots == [{("result", 0)}, frozenset()]


def test_a_call_is_seen_through():
    """What is in one loop within a call, and its result in one loop outside, is in one loop."""
    inner = jax.jit(lambda x: (jnp.sin(x) * 2, x.sum()))
    jaxpr, found = uses(lambda x: inner(x)[0] + 1, MANY)
    call = next(place for place, eqn in enumerate(jaxpr.eqns) if eqn.primitive.name in CALLS)
    results = jaxpr.eqns[call].outvars
    assert found.last[jaxpr.invars[0]] == call
    assert len(found.roots[0]) == 2
    assert ("result", 0) in found.roots[0]
    assert results[0] in found.last
    assert results[1] not in found.last
    one = jax.jit(lambda x: jnp.sin(x) * 2)
    assert uses(lambda x: one(x) + 1, MANY)[1].roots[0] == {("result", 0)}
    jaxpr, found = uses(lambda x: (one(x), x * 2), MANY)
    assert found.apart == {jaxpr.invars[0]}


def test_an_entry_that_is_spread_is_another_loop():
    """A number that many entries use is not worked out for each of them."""
    jaxpr, found = uses(lambda x, y: lax.mul(jnp.broadcast_to(jnp.sin(x), (50,)), y), 1.0, MANY)
    assert found.roots[1] == {("result", 0)}
    assert all(name != "mul" for _, name in found.roots[0])


def test_costly_functions_of_the_same_are_computed_once():
    def function(x, y):
        first = jnp.exp(2.0 * x) + jnp.exp(3.0 * x)
        return first * jnp.exp(2.0 * x), jnp.exp(2.0 * y), jnp.exp(3.0 * x), 2.0 * x

    jaxpr, found = uses(function, MANY, MANY)
    exps = [eqn.outvars[0] for eqn in jaxpr.eqns if eqn.primitive.name == "exp"]
    assert found.twins == {exps[2]: exps[0], exps[4]: exps[1]}
    assert not found.last.keys() & found.twins.keys()
    x, y = np.random.default_rng(1).normal(size=(2, *MANY.shape))
    for ours, theirs in zip(native.compile(function, x, y)(x, y), function(x, y), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-15)


def test_a_field_and_its_derivative_share_sines():
    jaxpr, found = uses(lambda x, dx: jax.jvp(lambda x: jnp.sin(x) * jnp.cos(x), (x,), (dx,)), MANY, MANY)
    names = {variable: "" for variable in jaxpr.invars}
    names |= {eqn.outvars[0]: eqn.primitive.name for eqn in jaxpr.eqns}
    assert sorted(names[twin] for twin in found.twins) == ["cos", "sin"]
    assert {names[one] for one in found.apart} >= {"sin", "cos"}
