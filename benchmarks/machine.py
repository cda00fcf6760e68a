"""When and where something was measured."""

import datetime
import os
import platform
import subprocess
from pathlib import Path


def here() -> dict[str, str]:
    """The date, the commit, the machine, and its load at the beginning."""
    folder = Path(__file__).parent
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=folder, capture_output=True, text=True)
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    return {
        "date": datetime.date.today().isoformat(),
        "commit": commit.stdout.strip() or "unknown",
        "machine": f"{os.cpu_count()} processors ({_processor()}), Python {platform.python_version()}",
        "load": load,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    known = dict(line.split(":", 1) for line in reversed(lines) if ":" in line)
    known = {name.strip(): value.strip() for name, value in known.items()}
    widest = "AVX-512" if "avx512f" in known.get("flags", "").split() else "no AVX-512"
    return f"{known.get('model name', platform.machine())}, {widest}"
