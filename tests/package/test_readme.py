"""The examples at the start of the README, as a user runs them; the files that documents name."""

import re
from pathlib import Path

import jax
import numpy as np
import pytest
from matplotlib import pyplot
from numpy.testing import assert_allclose

import lyaphybrid as lh

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
PLACES = ("lyaphybrid", "lyaphybrid/native", ".")  # from which paths are written in ARCHITECTURE.md


@pytest.mark.slow
def test_the_first_examples_run_and_lanes_are_single_runs(capsys):
    first, lanes = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names = {}
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        exec(first, names)
        pyplot.close("all")
        assert "Lyapunov spectrum per unit of time" in capsys.readouterr().out
        exec(lanes, names)
        printed = np.fromstring(capsys.readouterr().out.strip(" []\n"), sep=" ")
        alone = [float(names["largest"](restitution)) for restitution in (0.5, 0.6, 0.7, 0.8)]
    assert printed.shape == (4,)
    assert_allclose(printed, alone, rtol=0, atol=1e-7)
    assert names["spectrum"].status == lh.STATUS.ok


@pytest.mark.parametrize(("document", "least"), [("ARCHITECTURE.md", 20), ("README.md", 4), ("CONTRIBUTING.md", 2)])
def test_documents_name_files_that_are_there(document, least):
    named = set(re.findall(r"((?:\w+/)+\w+\.py)", (ROOT / document).read_text()))
    assert len(named) > least
    assert [name for name in named if not any((ROOT / place / name).exists() for place in PLACES)] == []
