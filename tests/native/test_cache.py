"""Machine code on disk: found again by other processes, bounded, and never trusted when damaged."""

import ctypes
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

from lyaphybrid.native import Compiled, compile
from lyaphybrid.native.bridge import compiled as _compiled
from lyaphybrid.native.machine import cache as _cache

COUNT = """
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
from lyaphybrid.native import compile
from lyaphybrid.native.machine import tiers
made = []
original = tiers.object_code
tiers.object_code = lambda *given: made.append(1) or original(*given)
def body(carry, x):
    matrix, total = carry
    matrix = matrix.at[1].set(matrix[0] + x)
    return (matrix[::-1], total + jnp.sum(matrix)), matrix
def program(matrix):
    flag = jnp.sum(matrix) > 0
    return jax.lax.scan(body, (jax.lax.cond(flag, lambda m: m + 1, lambda m: m.at[0].set(2.0), matrix), 0.0), matrix)
print(float(compile(program, jnp.ones((20, 20)))(jnp.ones((20, 20)))[0][1]), len(made))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("LYAPHYBRID_CACHE", str(tmp_path))
    return tmp_path


def processes(number, **environment):
    """Run the program in so many processes at once."""
    running = [
        subprocess.Popen([sys.executable, "-c", COUNT], env=os.environ | environment, stdout=subprocess.PIPE, text=True)
        for _ in range(number)
    ]
    outputs = [process.communicate()[0].split() for process in running]
    assert all(process.returncode == 0 for process in running)
    return outputs


@pytest.mark.slow
def test_a_second_process_compiles_nothing(folder):
    (first,) = processes(1, PYTHONHASHSEED="1")
    (second,) = processes(1, PYTHONHASHSEED="2")
    assert first == [second[0], "1"]
    assert second[1] == "0"


@pytest.mark.slow
def test_several_processes_share_the_folder(folder):
    outputs = processes(3)
    assert len({value for value, _ in outputs}) == 1
    assert [file.suffix for file in folder.iterdir()] == [".o"]


def test_a_program_comes_from_the_disk(folder):
    assert _cache.kept("a program", lambda: b"code") == b"code"
    assert _cache.kept("a program", lambda: b"other code") == b"code"
    assert _cache.kept("another program", lambda: b"other code") == b"other code"


@pytest.mark.parametrize("damage", [lambda content: content[:-1], lambda content: b"", lambda content: content + b"x"])
def test_damaged_entries_are_compiled_anew(folder, damage):
    double = compile(lambda x: 2 * x, 1.0)
    (entry,) = folder.iterdir()
    entry.write_bytes(damage(entry.read_bytes()))
    before = entry.read_bytes()
    assert float(compile(lambda x: 2 * x, 1.0)(3.0)) == float(double(3.0)) == 6
    assert entry.read_bytes() != before


def test_the_least_recently_used_go_first(folder, monkeypatch):
    monkeypatch.setattr(_cache, "MOST_BYTES", 3 * 1100)
    for age, name in enumerate(["old", "used", "new"]):
        _cache.kept(name, lambda: b"x" * 1000)
        newest = max(folder.iterdir(), key=lambda file: file.stat().st_mtime_ns)
        os.utime(newest, (1000 + age, 1000 + age))
    _cache.kept("used", lambda: b"not asked for")  # touches it
    _cache.kept("one more", lambda: b"x" * 1000)
    assert sum(file.stat().st_size for file in folder.iterdir()) <= 3 * 1100
    assert _cache.kept("used", lambda: b"anew") == b"x" * 1000
    assert _cache.kept("old", lambda: b"anew") == b"anew"


def test_off_keeps_nothing(monkeypatch, tmp_path):
    monkeypatch.setenv("LYAPHYBRID_CACHE", "off")
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: str(tmp_path / "cache"))
    assert _cache.folder() is None
    assert float(compile(lambda x: x + 2.5, 1.0)(jnp.float64(1.0))) == 3.5
    assert not (tmp_path / "cache").exists()


def test_a_folder_that_cannot_be_written_is_no_error(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("LYAPHYBRID_CACHE", str(tmp_path / "file" / "below"))
    assert float(compile(lambda x: x + 3.5, 1.0)(jnp.float64(1.0))) == 4.5


def told_version(code):
    """What a handler answers when XLA asks for the version of its interface: offsets in bytes as in c_api.h."""
    frame, extension, metadata = (ctypes.create_string_buffer(160) for _ in range(3))
    ctypes.c_void_p.from_buffer(frame, 8).value = ctypes.addressof(extension)
    ctypes.c_int32.from_buffer(extension, 8).value = 1
    ctypes.c_void_p.from_buffer(extension, 24).value = ctypes.addressof(metadata)
    ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(code.address("handler"))(ctypes.addressof(frame))
    return tuple((ctypes.c_int32 * 2).from_buffer(metadata, 24))


def test_code_is_that_of_every_version_of_the_interface(folder, monkeypatch):
    """Another JAX finds the entry, and hears its own version."""
    program = jax.make_jaxpr(lambda x: 2 * x)(jnp.arange(3.0))
    here = told_version(Compiled(program))
    entries = sorted(folder.iterdir())
    assert entries  # the first code, and the optimised one
    assert here[1] > 0
    monkeypatch.setattr(_compiled, "filled", lambda: {"version": (7, 99)})
    assert told_version(Compiled(program)) == (7, 99)
    assert sorted(folder.iterdir()) == entries
