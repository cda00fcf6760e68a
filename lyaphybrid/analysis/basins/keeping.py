"""Steps of a long computation, each of which a checkpoint keeps as soon as it is done."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np

from ..._arguments import flag
from ..._jax.hashes import hash_of_arrays, hash_of_function
from ..._version import __version__
from ...engine.host import checkpoints
from .recognition import Attractor
from .sampling import Sampling

__all__ = ["KeptSteps", "as_arrays", "attractors_in", "kept_steps"]

FEW_SAMPLES_OF_RUN = 2  # of the run by which a computation is recognised
ARRAYS_OF_ATTRACTOR = len(Attractor._fields)


class KeptSteps:
    """Runs the steps of a computation in their order; what a file holds of them is not computed again."""

    def __init__(self, file: checkpoints.Checkpoint | None = None):
        self.file, self.number, self.interrupted = file, 0, False

    @property
    def are_kept(self) -> bool:
        """Whether there is a file."""
        return self.file is not None

    def __call__(self, compute: Callable[[], list[np.ndarray]]) -> list[np.ndarray]:
        """The arrays of the next step. After Ctrl-C (`interrupted`) no step is kept."""
        number, self.number = self.number, self.number + 1
        if self.file is not None and number in self.file.parts:
            return self.file.parts[number].leaves
        found = [np.asarray(one) for one in compute()]
        if self.file is not None and not self.interrupted:
            self.file.keep(number, found)
        return found


@contextmanager
def kept_steps(
    path: str | os.PathLike[str] | None, resume: bool, sampling: Sampling, start, identity: dict[str, Any]
) -> Iterator[KeptSteps]:
    """The steps of a computation with its file, if it has a path; this is written at the end, however it comes.

    Args:
        path: of the checkpoint, or None.
        resume: whether to go on from it.
        sampling: how starts are run.
        start: time, mode and state of one of them.
        identity: arrays by name that must be the same, too.
    """
    flag("resume", resume)
    if path is None:
        yield KeptSteps()
        return
    t, mode, x = start
    lane, shared = sampling.lane(sampling.gap, FEW_SAMPLES_OF_RUN), sampling.shared(t, mode)
    header = {
        "system, args or method": hash_of_function(lambda x: lane(shared, x), x),
        **{name: hash_of_arrays({name: np.asarray(one)}) for name, one in identity.items()},
        "version": f"lyaphybrid {__version__}, jax {jax.__version__}",
    }
    file = checkpoints.opened(path, resume, header, 1.0, 1, extends=False)
    try:
        yield KeptSteps(file)
    finally:
        file.write()


def as_arrays(attractors: list[Attractor]) -> list[np.ndarray]:
    """Attractors as arrays."""
    return [np.asarray(one) for attractor in attractors for one in attractor]


def attractors_in(arrays: list[np.ndarray]) -> list[Attractor]:
    """What `as_arrays` was given."""
    rows = [arrays[i : i + ARRAYS_OF_ATTRACTOR] for i in range(0, len(arrays), ARRAYS_OF_ATTRACTOR)]
    return [Attractor(points, modes, int(period), float(radius)) for points, modes, period, radius in rows]
