"""The matrix of Pythons, JAXs and ways to run: ``python -m tests.portability [--python …] [--jax …] [--out FILE]``.

A row of the matrix is a fresh virtual environment with one Python and one JAX; in each way (`WAYS`) the tests of
tests/package/test_portable.py run in it. Prints a table, writes it as JSON, and ends with 1 if any cell failed.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TESTS = "tests/package/test_portable.py"
PYTHONS = "3.11", "3.12", "3.13"
OLDEST, MIDDLE = "0.8.0", "0.10.1"
JAXS = OLDEST, MIDDLE, "newest"
WAYS: dict[str, dict[str, str]] = {
    "native": {"LYAPHYBRID_ENGINE": "native"},
    "xla": {"LYAPHYBRID_ENGINE": "xla"},
    "two devices": {"LYAPHYBRID_ENGINE": "native", "XLA_FLAGS": "--xla_force_host_platform_device_count=2"},
    "float32": {"LYAPHYBRID_ENGINE": "native", "LYAPHYBRID_TEST_FLOAT32": "1"},
}
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
    subprocess.run([own, "-m", "pip", "install", "-qq", f"{ROOT}[test]", *wanted], check=True)
    return own


def tested(python: Path, way: dict[str, str]) -> dict:
    """How the tests went: passed, failed, the last lines of what they printed, and the seconds."""
    started, own = time.perf_counter(), {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | way
    command = [python, "-m", "pytest", "-q", "-n", "0", "-m", "slow or not slow", "--tb=line", TESTS]
    done = subprocess.run(command, cwd=ROOT, env=own, capture_output=True, text=True)
    last = done.stdout.strip().splitlines()[-12:] or done.stderr.strip().splitlines()[-12:]
    return {"green": done.returncode == 0, "said": last, "seconds": round(time.perf_counter() - started, 1)}


def cells(pythons: list[str], jaxs: list[str], kept: Path | None) -> list[dict]:
    """One row per Python and JAX."""
    rows = []
    for version in pythons:
        python = interpreter(version)
        for jax in jaxs:
            row: dict = {"asked": {"python": version, "jax": jax}}
            rows.append(row)
            if python is None:
                row["missing"] = f"no Python {version} on this machine"
                print(f"{version} jax {jax}: {row['missing']}", flush=True)
                continue
            place = Path(tempfile.mkdtemp(prefix="portable-", dir=kept))
            try:
                own = install(python, jax, place)
                row["versions"] = json.loads(subprocess.check_output([own, "-c", VERSIONS]))
                row["ways"] = {name: tested(own, way) for name, way in WAYS.items()}
            except subprocess.CalledProcessError as error:
                row["missing"] = f"the installation failed: {error}"
            finally:
                if kept is None:
                    shutil.rmtree(place)
            print(line(row), flush=True)
    return rows


def line(row: dict) -> str:
    """A row in words."""
    asked = f"Python {row['asked']['python']}, jax {row['asked']['jax']}"
    if "missing" in row:
        return f"{asked}: {row['missing']}"
    ways = (f"{name} {'green' if cell['green'] else 'RED'} ({cell['seconds']} s)" for name, cell in row["ways"].items())
    red = [said for cell in row["ways"].values() if not cell["green"] for said in cell["said"]]
    return "\n    ".join([f"{asked} ({row['versions']['jax']}): {', '.join(ways)}", *red])


def main() -> int:
    """Run the matrix; 0 if no cell is red."""
    parser = argparse.ArgumentParser("python -m tests.portability", description=__doc__)
    parser.add_argument("--python", nargs="+", default=PYTHONS, help="versions, such as 3.11")
    parser.add_argument("--jax", nargs="+", default=JAXS, help="versions, or newest")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "portability.json", help="the table as JSON")
    parser.add_argument("--keep", type=Path, help="a folder in which the environments are kept")
    options = parser.parse_args()
    rows = cells(list(options.python), list(options.jax), options.keep)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(rows, indent=1))
    red = sum(not cell["green"] for row in rows for cell in row.get("ways", {}).values())
    broken = sum("installation" in row.get("missing", "") for row in rows)
    print(f"{options.out}: {red} red cells, {broken} broken installations")
    return int(red + broken > 0)


if __name__ == "__main__":
    sys.exit(main())
