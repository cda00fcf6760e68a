"""The C that the benchmarks compare with is fair: what it is compiled to, not only what is said about it."""

import pytest

from benchmarks import many_disks, references


@pytest.fixture(autouse=True)
def needs_a_compiler():
    """The package needs none, only the comparison: as in `python -m benchmarks`, the reason is said (pytest -rs)."""
    try:
        references.compiler()
    except references.NoCompilerError as reason:
        pytest.skip(str(reason))


def test_the_c_computes_what_is_known():
    assert [check.name for check in references.validate() if not check.passed] == []


def test_the_c_of_many_disks_computes_what_is_known():
    assert [check.name for check in many_disks.validate() if not check.passed] == []


def test_the_c_takes_square_roots_by_an_instruction(tmp_path):
    # A call that may set errno in a loop costs the hard disks a factor of 2.7, and flattered our ratios once.
    careless = tuple(flag for flag in references.FLAGS if flag != "-fno-math-errno")
    for name, flags, calls in (("careless", careless, True), ("ours", references.FLAGS, False)):
        references.build(str(tmp_path / name), flags)
        assert (b"\0sqrt\0" in (tmp_path / name).read_bytes()) is calls, name  # the first: that it would be seen
