"""What the walk through a program does itself: in which form operands reach a rule, what is refused, what it writes."""

import re

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
import pytest
from jax import lax

from lyaphybrid import native
from lyaphybrid.native.lowering import lowering
from lyaphybrid.native.lowering.lowering import Lowering, lower
from lyaphybrid.native.lowering.unsupported import UnsupportedError
from lyaphybrid.native.lowering.values import RowVectors


def text(function, *operands, small=16, **options) -> str:
    """What a function is lowered to."""
    return lower(jax.make_jaxpr(function)(*operands), small, **options)


@pytest.mark.parametrize(("primitive", "in_rows"), [("cumsum", False), ("optimization_barrier", True)])
def test_rows_reach_a_rule_only_if_it_takes_them(monkeypatch, primitive, in_rows):
    """Others get entries."""
    forms, rule = [], lowering.RULES[primitive]
    monkeypatch.setitem(
        lowering.RULES, primitive, lambda b, eqn, x, *rest: forms.append(type(x)) or rule(b, eqn, x, *rest)
    )
    change = {"cumsum": lambda c: lax.cumsum(c), "optimization_barrier": lax.optimization_barrier}[primitive]
    program = lambda frame: lax.fori_loop(0, 100, lambda i, c: change(c * 1.5) + c, frame)  # noqa: E731
    assert "fmul <4 x double>" in text(program, np.ones((2, 3)), small=32, columns=3)
    assert set(forms) == {RowVectors if in_rows else np.ndarray}


def test_a_rule_for_rows_that_returns_none_leaves_it_to_the_other(monkeypatch):
    seen = []
    monkeypatch.setitem(lowering.IN_ROWS, "cumsum", lambda b, eqn, x: seen.append(type(x)))
    program = lambda frame: lax.fori_loop(0, 100, lambda i, c: lax.cumsum(c * 1.5), frame)  # noqa: E731
    assert "fmul <4 x double>" in text(program, np.ones((2, 3)), small=32, columns=3)
    assert set(seen) == {RowVectors}


@pytest.mark.parametrize("small", [1, 16])
def test_a_constant_without_a_type_here_is_refused_where_it_stands(small):
    with pytest.raises(UnsupportedError, match="complex128"):
        Lowering(small).constant_value(np.array([1 + 2j, 3.0]))


def test_one_run_is_lowered_for_one_run_and_its_indices_are_not_checked():
    program = jax.make_jaxpr(lambda x, i: x[i] * x)(np.ones(50), 1)
    assert "x double>" not in lower(program, 16)
    assert "abort" not in lower(program, 16)
    assert "abort" in lower(program, 16, checked=True)


def test_what_a_broadcast_reads_again_and_again_is_computed_once():
    """Unless it is only moved about, which costs nothing."""
    y = np.ones((50, 50))
    assert "alloca" in text(lambda x, y: jnp.tanh(x)[:, None] * y, np.ones(50), y)
    assert "alloca" not in text(lambda x, y: x[::-1][:, None] * y, np.ones(50), y)


def repeated(times):
    """So many equations in a row."""

    def function(x):
        for _ in range(times):
            x = x * 1.5
        return x

    return function


def test_lanes_that_part_in_too_much_of_the_code_are_refused():
    """Lines in branches that lanes do not share, of all; what is seldom run counts on neither side."""

    def counts(often, **options):
        function = lambda x: native.seldom(repeated(often))(lax.cond(x[0] > 0, repeated(30), lambda x: x, x))  # noqa: E731
        return text(function, np.ones(5), lanes=2, wide=[True], **options)

    with pytest.raises(UnsupportedError, match="lanes that part in") as caught:
        counts(1, most_apart=0.0)
    apart, lines = map(int, re.findall(r"\d+", str(caught.value)))
    assert 30 * 5 <= apart < lines
    for often in (1, 200):
        with pytest.raises(UnsupportedError, match=f"part in {apart} of {lines} lines"):
            counts(often, most_apart=(apart - 0.5) / lines)
        assert " fmul " in counts(often, most_apart=(apart + 0.5) / lines)
    assert " fmul " in counts(1)


def test_what_a_branch_computes_is_used_behind_it_only_where_it_was_run_through():
    """LLVM verifies it; lanes may jump over a long branch."""
    function = lambda x: lax.cond(x[0] > 0, repeated(200), lambda x: x, x)  # noqa: E731
    written = text(function, np.ones(5), lanes=2, wide=[True])
    assert " poison, " in written
    llvm.parse_assembly(written).verify()
