"""The C that the benchmarks compare with is fair: what it is compiled to, not only what is said about it."""

import subprocess

import pytest

from benchmarks import references


def _compiled(flags, folder) -> bytes:
    target = folder / "references.so"
    sources = sorted(map(str, references.SOURCES.glob("*.c")))
    subprocess.run([references.compiler(), *flags, *sources, "-o", str(target), "-lm"], check=True)
    return target.read_bytes()


@pytest.fixture(autouse=True)
def needs_a_compiler():
    try:
        references.compiler()
    except references.NoCompilerError as reason:
        pytest.skip(str(reason))


def test_the_c_computes_what_is_known():
    assert [check.name for check in references.validate() if not check.passed] == []


def test_the_c_takes_square_roots_by_an_instruction(tmp_path):
    # A call that may set errno in a loop costs the hard disks a factor of 2.7, and flattered our ratios once.
    careless = [flag for flag in references.FLAGS if flag != "-fno-math-errno"]
    assert b"\0sqrt\0" in _compiled(careless, tmp_path)  # or this test would see nothing
    assert b"\0sqrt\0" not in _compiled(references.FLAGS, tmp_path)
