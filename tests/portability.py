"""The matrix of Pythons, JAXs and ways to run: ``python -m tests.portability [--python …] [--jax …] [--out FILE]``.

A row of the matrix is a fresh virtual environment with one Python, one JAX and the installed package; in each way
(`WAYS`) the tests of tests/package/test_portable.py run in it. Prints a table, and ends with 1 if any cell failed.
What was found, without times, goes to tests/portability.json, or to build/ if only a part of the matrix was asked for.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TESTS = "tests/package/test_portable.py"
TABLE = ROOT / "tests" / "portability.json"
PYTHONS = "3.11", "3.12", "3.13"
OLDEST, MIDDLE = "0.8.0", "0.10.1"
JAXS = OLDEST, MIDDLE, "newest"
WAYS: dict[str, dict[str, str]] = {
    "native": {"LYAPHYBRID_ENGINE": "native"},
    "xla": {"LYAPHYBRID_ENGINE": "xla"},
    "two devices": {"LYAPHYBRID_ENGINE": "native", "XLA_FLAGS": "--xla_force_host_platform_device_count=2"},
    "float32": {"LYAPHYBRID_ENGINE": "native", "LYAPHYBRID_TEST_FLOAT32": "1"},
}
CHOSEN = {"two devices": ["-k", "devices or lanes or sweep or jumps"]}  # what can tell two devices from one
OURS = {"PYTHONPATH", "PYTHONDONTWRITEBYTECODE"}  # settings of who starts this that the tests do not take over
VERSIONS = """
import json, platform, jax, jaxlib, llvmlite, numpy
found = {module.__name__: module.__version__ for module in (jax, jaxlib, llvmlite, numpy)}
print(json.dumps({"python": platform.python_version()} | found))
"""


def interpreter(version: str) -> str | None:
    """The path of a Python of this version: on the PATH, or among pyenv's."""
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    names = [f"python{version}", *map(str, sorted(kept.glob(f"{version}.*/bin/python")))]
    return next((name for name in names if _is(name, version)), None)


def _is(name: str, version: str) -> bool:
    try:
        found = subprocess.run([name, "-c", "import sys; print(*sys.version_info[:2], sep='.')"], capture_output=True)
    except OSError:
        return False
    return found.returncode == 0 and found.stdout.decode().strip() == version


def install(python: str, jax: str, place: Path) -> Path:
    """A fresh environment with this package and this JAX; returns its Python."""
    subprocess.run([python, "-m", "venv", place], check=True)
    own = place / ("Scripts" if os.name == "nt" else "bin") / "python"
    wanted = [] if jax == "newest" else [f"jax=={jax}", f"jaxlib=={jax}"]
    # Python compiles what is imported; all files of all packages would take longer than the tests.
    subprocess.run([own, "-m", "pip", "install", "-qq", "--no-compile", f"{ROOT}[test]", *wanted], check=True)
    return own


def tested(python: Path, way: str) -> dict:
    """How the tests went: how many passed and were skipped, the last lines of what they printed, and the seconds."""
    own = {name: value for name, value in os.environ.items() if name not in OURS} | WAYS[way]
    own["PYTHONSAFEPATH"] = "1"  # the installed package, not the one in this folder
    how = ["-q", "-n", "0", "-m", "slow or not slow", "--tb=line", *CHOSEN.get(way, [])]
    command = [python, "-m", "pytest", *how, TESTS]
    started = time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, env=own, capture_output=True, text=True)
    seconds = round(time.perf_counter() - started, 1)
    said = done.stdout.strip().splitlines()[-12:] or done.stderr.strip().splitlines()[-12:]
    counts = {word: int(count) for count, word in re.findall(r"(\d+) (passed|failed|skipped|error)", said[-1])}
    return {"green": done.returncode == 0, **counts, "said": said, "seconds": seconds}


def row(version: str, jax: str, kept: Path | None, before: list[dict]) -> dict:
    """The cells of one Python and one JAX; those of a row before it if pip chose the very same versions."""
    found: dict = {"python": version, "jax": jax}
    if (python := interpreter(version)) is None:
        return found | {"missing": f"no Python {version} on this machine"}
    place = Path(tempfile.mkdtemp(prefix="portable-", dir=kept))
    try:
        own = install(python, jax, place)
        found["versions"] = json.loads(subprocess.check_output([own, "-c", VERSIONS]))
        same = [one for one in before if one.get("versions") == found["versions"]]
        found["ways"] = same[0]["ways"] if same else {way: tested(own, way) for way in WAYS}
    except subprocess.CalledProcessError as error:
        found["missing"] = f"the installation failed: {error}"
    finally:
        if kept is None:
            shutil.rmtree(place)
    return found


def line(row: dict) -> str:
    """A row in words."""
    asked = f"Python {row['python']}, jax {row['jax']}"
    if "missing" in row:
        return f"{asked}: {row['missing']}"
    ways = (f"{name} {'green' if cell['green'] else 'RED'} ({cell['seconds']} s)" for name, cell in row["ways"].items())
    red = [said for cell in row["ways"].values() if not cell["green"] for said in cell["said"]]
    return "\n    ".join([f"{asked} ({row['versions']['jax']}): {', '.join(ways)}", *red])


def facts(row: dict) -> dict:
    """A row as it is kept: what would be found again anywhere."""
    ways = row.get("ways", {}).items()
    cells = {name: {k: v for k, v in cell.items() if k not in {"said", "seconds"}} for name, cell in ways}
    return row | ({"ways": cells} if cells else {})


def main() -> int:
    """Run the matrix; 0 if all of it is green."""
    parser = argparse.ArgumentParser("python -m tests.portability", description=__doc__)
    parser.add_argument("--python", nargs="+", default=PYTHONS, help="versions, such as 3.11")
    parser.add_argument("--jax", nargs="+", default=JAXS, help="versions, or newest")
    parser.add_argument("--out", type=Path, help="the table as JSON")
    parser.add_argument("--keep", type=Path, help="a folder in which the environments are kept")
    options = parser.parse_args()
    pythons, jaxs = tuple(options.python), tuple(options.jax)
    out = options.out or (TABLE if (pythons, jaxs) == (PYTHONS, JAXS) else ROOT / "build" / "portability.json")
    rows: list[dict] = []
    for version in pythons:
        for jax in jaxs:
            rows.append(row(version, jax, options.keep, rows))
            print(line(rows[-1]), flush=True)
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(json.dumps([facts(one) for one in rows], indent=1) + "\n")  # kept if a later row is stopped
    red = sum(not cell["green"] for one in rows for cell in one.get("ways", {}).values())
    missing = sum("missing" in one for one in rows)
    print(f"{out}: {red} red cells, {missing} rows missing")
    return int(red + missing > 0)


if __name__ == "__main__":
    sys.exit(main())
