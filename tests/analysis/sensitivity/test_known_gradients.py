"""No derivative of an exponent is trusted and wrong."""

import pytest

from known_gradients import KNOWN, METHODS, estimated, wrong_by

pytestmark = pytest.mark.slow


# f → c f is a test of its own for every method; here it would cost three minutes.
TESTED = [name for name in KNOWN if not name.startswith("faster")]


@pytest.mark.parametrize("name", TESTED)
def test_what_is_trusted_is_right(name):
    found = {method: estimated(name, method) for method in METHODS}
    trusted = {method: one for method, one in found.items() if one is not None and one.trust}
    assert tuple(trusted) == KNOWN[name].trusted
    for one in trusted.values():
        assert wrong_by(name, one) < 4, one


def test_there_are_enough_cases():
    assert len(TESTED) >= 12
