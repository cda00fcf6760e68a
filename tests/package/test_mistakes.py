"""Each mistake gets an answer: with what was given, what is wanted and what to do, soon, and without frames of JAX."""

import traceback
from pathlib import Path

import equinox
import jax
import mistakes
import numpy as np
import pytest

import lyaphybrid as lh
from fuzz.arguments import limited

SECONDS = 20  # of a processor: none hangs
FRAMES = 5  # of JAX, at most: 15 lines of a traceback
LIBRARIES = tuple(str(Path(module.__file__).parent) for module in (jax, equinox))


def answer(call) -> Exception:
    """The error that a call raises; another kind than ours is no answer."""
    with pytest.raises((ValueError, TypeError, AttributeError, lh.LyaphybridError)) as caught, limited(SECONDS):
        call()
    return caught.value


def lacking(message: str, words) -> list[str]:
    return [word for word in words if word not in message]


def frames_of_libraries(error: Exception) -> int:
    """In all that Python would print: the error, and those that it came from."""
    count = 0
    while error is not None:
        frames = traceback.extract_tb(error.__traceback__)
        count += sum(frame.filename.startswith(LIBRARIES) for frame in frames)
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return count


@pytest.mark.parametrize("name", mistakes.FUNCTIONS)
def test_mistakes_in_functions_name_the_line(name):
    mistake = mistakes.FUNCTIONS[name]
    error = answer(mistake.call)
    assert lacking(str(error), (*mistake.words, "(mistakes.py, line ", " is called with ")) == []
    assert frames_of_libraries(error) <= FRAMES
    assert not getattr(error, "__notes__", [])


@pytest.mark.parametrize("name", mistakes.ARGUMENTS)
def test_mistakes_in_arguments_say_what_to_do(name):
    mistake = mistakes.ARGUMENTS[name]
    error = answer(mistake.call)
    assert lacking(str(error), mistake.words) == []
    assert frames_of_libraries(error) <= FRAMES


def test_there_are_eighty():
    assert len(mistakes.FUNCTIONS) + len(mistakes.ARGUMENTS) >= 80


def test_the_line_is_the_one_of_the_mistake():
    """Also where the function calls another one."""
    source = Path(mistakes.__file__).read_text().splitlines()
    line = next(i for i, text in enumerate(source, 1) if "while x[0] > 1" in text)
    assert f"(mistakes.py, line {line})" in str(answer(mistakes.FUNCTIONS["while"].call))
    nested = mistakes.flow(lambda t, x, args: mistakes.with_while(t, x, args))
    assert f"(mistakes.py, line {line})" in str(answer(nested))


@pytest.mark.slow_cases("lyapunov_spectrum")
@pytest.mark.parametrize("verb", [lh.lyapunov_spectrum, lh.trajectory, lh.tangent_map])
def test_warnings_point_to_the_line_of_the_user(verb):
    with pytest.warns(UserWarning, match="x0 is float32") as caught:
        verb(lh.Map(lambda n, x, a: 3.7 * x * (1 - x)), np.array([0.3], np.float32), t1=10)
    assert [Path(one.filename).name for one in caught if "x0 is float32" in str(one.message)] == [Path(__file__).name]
