"""Single runs and sweeps on an accelerator, beside the CPU of the same machine: ``python -m benchmarks.accelerators``.

Each side runs in a process of its own. First the same short runs on both, whose exponents must agree; then sweeps of
growing size, each timed at its second call, with the seconds of the first one (which compiles) beside it.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import time

RUNS = {  # units of time or iterations: too short for chaos to magnify rounding
    "lorenz63": 2.0,
    "henon_heiles": 20.0,
    "impact_oscillator": 20.0,
    "friction_pendulum": 20.0,
    "spring_damper_dae": 2.0,
    "hard_disks": 2.0,
    "standard_map": 10.0,
}
TOLERANCE = 1e-8
SIZES = (4_096, 16_384, 65_536)
T1 = {"lorenz": 10.0, "impact": 50.0}  # of each lane
PATIENCE = 150  # seconds for one side of one comparison


def singles() -> dict[str, list[float]]:
    """Exponents of short runs of the zoo."""
    import lyaphybrid as lh

    found = {}
    for name, t1 in RUNS.items():
        began = time.perf_counter()
        problem = getattr(lh.zoo, name)()
        spectrum = problem.spectrum(t1=t1, transient=0.0, blocks=2, throw=False)
        found[name] = [float(x) for x in spectrum.finite_exponents]
        print(f"{name}: {time.perf_counter() - began:.1f} s", file=sys.stderr, flush=True)
    return found


def sweep(name: str, lanes: int) -> dict[str, float]:
    """One sweep, twice."""
    import jax.numpy as jnp
    import numpy as np

    import lyaphybrid as lh
    from lyaphybrid.engine.host import devices
    from lyaphybrid.sweeps.plans import plan
    from lyaphybrid.sweeps.sweeping import Work

    if name == "lorenz":
        problem, axis, values = lh.zoo.lorenz63(), "rho", np.linspace(26.0, 30.0, lanes)
        how = {"method": lh.RungeKutta("rk4", dt=0.01), "every": 10}
    else:
        problem, axis, values = lh.zoo.impact_oscillator(), "restitution", np.linspace(0.79, 0.81, lanes)
        how = {"method": lh.RungeKutta("rk4", dt=0.02), "every": 1.0}
    start = jnp.asarray(problem.x0)

    def run(args):
        return lh.lyapunov_spectrum(problem.system, start, args, t1=T1[name], blocks=2, throw=False, **how)

    grid = plan({axis: values}, None, problem.args)
    work = Work.of(None, run, problem.args, grid, lanes if devices.are_wanted() else 256)
    seconds = []
    for _ in range(2):
        began = time.perf_counter()
        work.compute(work.pieces(), lambda index, results: None, None, None)
        seconds.append(time.perf_counter() - began)
    exponents = work.variables["exponents"]
    return {"first": seconds[0], "second": seconds[1], "mean": float(np.nanmean(exponents[:, 0]))}


def side(what: str, platform: str) -> dict | None:
    """The same in a process of its own, on this platform; None where that fails or takes too long."""
    environment = os.environ | ({"JAX_PLATFORMS": "cpu"} if platform == "cpu" else {})
    command = [sys.executable, "-m", "benchmarks.accelerators", "--only", what]
    try:
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True, timeout=PATIENCE)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        print(f"{what} on {platform}: {error}", file=sys.stderr, flush=True)
        return None
    return json.loads(done.stdout.splitlines()[-1])


def compared() -> bool:
    """Whether the exponents of short runs agree."""
    there, here = side("singles", "accelerator") or {}, side("singles", "cpu") or {}
    furthest = 0.0
    for name in RUNS:
        pairs = zip(there.get(name, [math.inf]), here.get(name, [0.0]), strict=True)
        apart = max(abs(a - b) for a, b in pairs)
        furthest = max(furthest, apart)
        print(f"{name:20s} exponents differ by {apart:.1e}", flush=True)
    return furthest < TOLERANCE


def timed(name: str, lanes: int) -> bool:
    """Print a line for one sweep; whether both sides have run."""
    on, off = (side(f"{name}:{lanes}", platform) for platform in ("accelerator", "cpu"))
    if on is None or off is None:
        print(f"{name:8s}  {lanes:7d}  failed on the {'accelerator' if on is None else 'processors'}", flush=True)
        return False
    times = f"{on['first']:17.2f}  {on['second']:8.2f}  {off['first']:18.2f}  {off['second']:8.2f}"
    print(
        f"{name:8s}  {lanes:7d}  {times}  {on['second'] / off['second']:6.2f}   {on['mean']:.4f} {off['mean']:.4f}",
        flush=True,
    )
    return True


def main() -> int:
    """Compare and time; 1 where the two sides do not agree, or one fails."""
    parser = argparse.ArgumentParser("python -m benchmarks.accelerators", description=__doc__.split("\n")[0])
    parser.add_argument("--only", metavar="singles|SWEEP:LANES", help="one side of one comparison, as JSON")
    what = parser.parse_args().only
    import jax

    jax.config.update("jax_enable_x64", True)
    if what:
        name, _, lanes = what.partition(":")
        print(json.dumps(sweep(name, int(lanes)) if lanes else singles()))
        return 0
    print(
        f"accelerator: {jax.devices()[0].device_kind}; {os.cpu_count()} processors; JAX {jax.__version__}", flush=True
    )
    right = compared()
    print("sweep       lanes  accelerator: first    second  processors: first    second   ratio   means of λ1")
    for name in T1:
        for lanes in SIZES:
            right &= timed(name, lanes)
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
