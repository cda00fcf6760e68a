"""How a run says how far it is: not at all, by the user's function, by a bar, by lines."""

import io
import itertools

import pytest

from lyaphybrid.engine.host.reporting import line_of_progress, reporter


@pytest.mark.parametrize("progress", [None, False])
def test_nothing_is_said(progress, capsys):
    report = reporter(progress)
    for fraction in (0.5, 1.0, None):
        report(fraction)
    assert capsys.readouterr() == ("", "")


def test_a_function_gets_the_fractions_and_not_the_end():
    seen = []
    report = reporter(seen.append)
    for fraction in (0.25, 1.0, None):
        report(fraction)
    assert seen == [0.25, 1.0]


def test_a_bar_stands_at_the_part_that_is_done(capsys):
    report = reporter(True, total=200, unit="points")
    report(0.5)
    report(1.0)
    report(None)
    said = capsys.readouterr().err
    assert "100%" in said
    assert "points/s" in said


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_file_gets_a_line_for_each_tenth():
    stream = io.StringIO()
    with line_of_progress("sweep", stream) as report:
        for i in range(101):
            report(i / 100)
    lines = stream.getvalue().splitlines()
    assert lines[0] == "sweep: compiling"
    done = [int(line.split()[1]) for line in lines[1:]]
    assert (done[0], done[-1]) == (0, 100)
    assert all(10 <= later - sooner <= 11 for sooner, later in itertools.pairwise(done[:-1]))


def test_a_terminal_gets_one_line_that_is_cleared_at_the_end():
    stream = Terminal()
    with line_of_progress("sweep", stream) as report:
        report(0.333)
    said = stream.getvalue()
    assert "\n" not in said
    assert "sweep: 33 % after 0 s" in said
    assert said.endswith("\r\x1b[K\r")
