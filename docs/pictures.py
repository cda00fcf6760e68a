"""Make the two pictures of the README: `python -m docs.pictures`. They are committed, in docs/_static/.

It also prints what the example of the README prints.
"""

import re
from pathlib import Path

import jax
from matplotlib import pyplot

import lyaphybrid as lh
from lyaphybrid.zoo import pictures

ROOT = Path(__file__).parents[1]
STATIC = Path(__file__).parent / "_static"
BLOCK = re.compile(r"```python\n(.*?)```", flags=re.DOTALL)


def disks() -> None:
    """64 hard disks and the perturbation of them that grows fastest."""
    gas = lh.zoo.hard_disks(n=64, density=0.7)
    run = gas.spectrum(t1=50.0, k=1)
    _, ax = pyplot.subplots(figsize=(4.8, 4.8), layout="constrained")
    pictures.disks(gas, run.x, run.frame[:, 0], ax=ax)
    ax.figure.savefig(STATIC / "hard_disks.png", dpi=110)


def first_spectrum() -> None:
    """The figure that the README's example draws."""
    code = BLOCK.search((ROOT / "README.md").read_text())[1]
    exec(code, {})
    figure = pyplot.gcf()
    figure.set_size_inches(7.0, 3.4)
    figure.savefig(STATIC / "first_spectrum.png", dpi=110)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    disks()
    first_spectrum()
