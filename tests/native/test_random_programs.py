"""Random programs, compiled natively and by XLA."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from many_programs import wrong_results
from random_programs import random_program


@pytest.mark.slow
@pytest.mark.parametrize("examples", [2, pytest.param(25, marks=pytest.mark.slow)])
def test_random_programs(examples):
    @settings(max_examples=examples)
    @given(st.data())
    def agree(data):
        program, operands = random_program(lambda n: data.draw(st.integers(0, n - 1)))
        assert not wrong_results(program, operands)

    agree()
