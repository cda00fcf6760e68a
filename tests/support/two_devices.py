"""A sweep of impact oscillators, chaotic ones among them, on a CPU that is divided into two devices, into a file.

``python tests/support/two_devices.py FILE`` as anyone would; ``… FILE sharded`` the way accelerators do it.
"""

import os
import sys

import numpy as np

FREQUENCIES, RESTITUTIONS = np.linspace(2.2, 3.0, 9), np.linspace(0.3, 0.9, 5)


def swept(**keywords):
    """45 points, 7 a chunk: uneven for two devices."""
    import lyaphybrid as lh

    problem = lh.zoo.impact_oscillator()

    def run(args):
        return problem.spectrum(args=args, t1=100.0, transient=0.0, blocks=8, throw=False)

    over = {"omega": FREQUENCIES, "restitution": RESTITUTIONS}
    return lh.sweep(run, over, args=problem.args, **{"chunk": 7, "progress": False} | keywords)


if __name__ == "__main__":
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"
    import jax

    jax.config.update("jax_enable_x64", True)
    if "sharded" in sys.argv:
        from lyaphybrid.engine.host import devices

        devices.are_wanted = lambda: True
    found = swept()
    assert jax.local_device_count() == 2
    np.savez(sys.argv[1], **{name: found[name].values for name in found.data_vars})
