"""Wheel and sdist as a user gets them: ``python -m tests.release [--python 3.11]``.

Builds both in a fresh environment, looks at what they hold, installs each in a fresh environment of its own, and runs a
part of the fast tests, those that the sdist holds, against the installed wheel. Ends with 1 if anything is wrong.
"""

import argparse
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

from tests.portability import ROOT, interpreter

# Tests of the sdist that run against the wheel: systems, events, exponents, the zoo, prints, the compiler.
CHOSEN = (
    "tests/package/test_portable.py",
    "tests/package/test_precision.py",
    "tests/analysis/test_exact_values.py",
    "tests/native/test_elementary.py",
)
IN_WHEEL = ("lyaphybrid/py.typed", "lyaphybrid/zoo/__init__.py", "licenses/LICENSE")
IN_SDIST = (
    "tests/conftest.py",
    "tests/data/",
    "docs/howto/index.md",
    "docs/gallery/",
    "notebooks/",
    "README.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "LICENSE",
    "constraints.txt",
    "pyproject.toml",
)
LEFTOVERS = ("__pycache__", ".pyc", "build/", ".venv", ".git/", "lyaphybrid-out", ".pytest_cache", ".ruff_cache")
WORKS = "import lyaphybrid as lh; print(lh.__version__); print(lh.zoo.cat_map().spectrum(t1=1000))"


def faults(names: list[str], wanted: tuple[str, ...]) -> list[str]:
    """What is missing among the names of an archive, and what should not be there."""
    missing = [f"missing: {one}" for one in wanted if not any(one in name for name in names)]
    return missing + [f"left over: {name}" for name in names if any(one in name for one in LEFTOVERS)]


def environment(python: str, place: Path, *wanted: str) -> Path:
    """A fresh environment with these packages; returns its Python."""
    subprocess.run([python, "-m", "venv", place], check=True)
    subprocess.run([place / "bin" / "python", "-m", "pip", "install", "-qq", *wanted], check=True)
    return place / "bin" / "python"


def main() -> int:
    """Build, look, install, test; 0 if all is well."""
    parser = argparse.ArgumentParser("python -m tests.release", description=__doc__)
    parser.add_argument("--python", default="3.11", help="version, such as 3.13")
    version = parser.parse_args().python
    python = interpreter(version)
    if python is None:
        parser.error(f"no Python {version} on this machine")
    with tempfile.TemporaryDirectory(prefix="release-") as kept:
        folder = Path(kept)
        builder = environment(python, folder / "builder", "build", "twine")
        subprocess.run([builder, "-m", "build", "-o", folder / "dist", ROOT], check=True, stdout=subprocess.DEVNULL)
        (wheel,), (sdist,) = (folder / "dist").glob("*.whl"), (folder / "dist").glob("*.tar.gz")
        subprocess.run([builder, "-m", "twine", "check", "--strict", wheel, sdist], check=True)
        with tarfile.open(sdist) as archive:
            wrong = faults(archive.getnames(), IN_SDIST)
            archive.extractall(folder, filter="data")
        with zipfile.ZipFile(wheel) as archive:
            wrong += faults(archive.namelist(), IN_WHEEL)
        print("\n".join(wrong) or f"{wheel.name}, {sdist.name}: hold what they should", flush=True)
        of_sdist = environment(python, folder / "of_sdist", str(sdist))
        subprocess.run([of_sdist, "-c", WORKS], check=True, cwd=folder)
        of_wheel = environment(python, folder / "of_wheel", f"{wheel}[test]")
        unpacked = folder / sdist.name.removesuffix(".tar.gz")
        (unpacked / "lyaphybrid").rename(folder / "aside")  # the installed package is tested, not this one
        command = [of_wheel, "-m", "pytest", "-q", "-n", "0", *CHOSEN]
        return int(subprocess.run(command, cwd=unpacked).returncode != 0 or bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
