"""JiTCODE: `jitcode_lyap`, compiled by the C compiler of the machine."""

import functools
import os
import tempfile
import warnings

import jitcode
import numpy as np
import symengine

from benchmarks.peers.adapters import Bound
from benchmarks.peers.workloads import Workload

TOLERANCES = {"dopri5": (1e-4, 1e-6, 1e-8, 1e-10, 1e-12), "dop853": (1e-6, 1e-8, 1e-10, 1e-12)}
TYPICAL = "dopri5 1e-08"
warnings.filterwarnings("ignore", module="jitc")


os.chdir(tempfile.mkdtemp())  # setuptools, by which it compiles, reads the pyproject.toml of the folder where it stands


def flow(workload: Workload) -> Bound:
    """The columns are drawn, by a generator without a seed: those of the first call are set again for each run."""
    (n, k), every = workload.frame.shape, workload.every
    state = [jitcode.y(i) for i in range(n)]
    equations = list(workload.formula(symengine)(jitcode.t, state, workload.p))
    location = jitcode.jitcode_lyap(equations, n_lyap=k, verbose=False).save_compiled()

    @functools.cache
    def system(setting):
        name, rtol = setting
        made = jitcode.jitcode_lyap(equations, n_lyap=k, module_location=location, verbose=False)
        made.set_integrator(name, rtol=rtol, atol=1e-2 * rtol)
        return made

    ladder = {f"{name} {rtol:.0e}": (name, rtol) for name, tolerances in TOLERANCES.items() for rtol in tolerances}
    drawing = system(ladder[TYPICAL])
    drawing.set_initial_value(workload.start, 0.0)
    begun = np.array(drawing.integrator._y)

    def run(setting, length):
        made = system(setting)
        jitcode.jitcode.set_initial_value(made, begun, 0.0)
        local = [made.integrate((i + 1) * every)[1] for i in range(round(length / every))]
        return np.mean(local, axis=0)

    return Bound(ladder, run, begun[n:].reshape(k, n).T, typical=list(ladder).index(TYPICAL))


KINDS = {"flow": flow}
