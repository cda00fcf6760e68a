"""Many cases by one compiled program, which takes them one after the other."""

import jax
import jax.numpy as jnp
import numpy as np

SIZE = 50  # cases of a call: others would compile anew


def in_batches(run, cases: dict[int, dict]):
    """(seed, case, answer) for each, run on the `args` of the cases."""
    seeds = list(cases)
    for begin in range(0, len(seeds), SIZE):
        some = seeds[begin : begin + SIZE]
        padded = [cases[seed]["args"] for seed in some + [some[0]] * (SIZE - len(some))]
        answers = jax.device_get(run(jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *padded)))
        for i, seed in enumerate(some):
            yield seed, cases[seed], jax.tree.map(lambda leaf, i=i: leaf[i], answers)


def judged(seed: int, **right: bool) -> dict[int, str]:
    """What is not right."""
    wrong = [name for name, good in right.items() if not good]
    return {seed: "wrong: " + ", ".join(wrong)} if wrong else {}
