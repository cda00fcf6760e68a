"""Random programs, compiled natively and by XLA."""

from hypothesis import given, settings
from hypothesis import strategies as st

from many_programs import wrong_results
from random_programs import random_program


@settings(max_examples=25)
@given(st.data())
def test_random_programs(data):
    program, operands = random_program(lambda n: data.draw(st.integers(0, n - 1)))
    assert not wrong_results(program, operands)
