"""What counts as a key, a sequence of integers and an array of numbers, in words of the arguments."""

import jax
import numpy as np
import pytest

from lyaphybrid import _arguments


def test_keys_of_both_kinds_are_keys():
    assert _arguments.is_key(jax.random.key(1))
    assert _arguments.is_key(jax.random.PRNGKey(1))  # two integers
    assert _arguments.is_key(np.array([1, 2], np.uint32))


@pytest.mark.parametrize("value", [1, None, [1, 2], np.array([1, 2]), np.array([1, 2, 3], np.uint32)])
def test_other_things_are_no_keys(value):
    assert not _arguments.is_key(value)
    assert not _arguments.is_key(jax.random.split(jax.random.key(1)))  # several


def test_integers_within_bounds():
    assert _arguments.integers("places", np.array([2, 0]), 0, 2) == (2, 0)
    assert _arguments.integers("places", iter([1]), 0, 2) == (1,)


@pytest.mark.parametrize("value", [3, [0, 3], [-1], [0.5], [True], "01"])
def test_what_is_not_integers_within_bounds(value):
    with pytest.raises(ValueError, match="places must be integers from 0 to 2; got "):
        _arguments.integers("places", value, 0, 2)
