"""The random automata of the reference as `lh.Hybrid`: one system per shape, every number in `args`."""

import functools

import jax.numpy as jnp

import lyaphybrid as lh

ARRAYS = ("A", "b", "mask", "c", "d", "a", "w", "p", "dir", "R", "r", "s", "u", "tgt")


@functools.cache
def automaton(modes: int, transitions: int) -> lh.Hybrid:
    """The hybrid system of a shape; direction and target are data, so each mode has two vector guards."""
    names = [f"q{q}" for q in range(modes)]
    fields = {name: functools.partial(_field, q) for q, name in enumerate(names)}
    jumps = []
    for q, name in enumerate(names):
        for both in (False, True):
            jumps.append(
                lh.Transition(
                    functools.partial(_guard, q, both),
                    functools.partial(_reset, q),
                    source=name,
                    target=functools.partial(_target, q),
                    direction=0 if both else -1,
                )
            )
    return lh.Hybrid(fields, jumps)


def arguments(group: dict, row: int | slice | list) -> dict:
    """The arrays of one member (or several) of a group."""
    return {name: jnp.asarray(group[name][row]) for name in ARRAYS}


def _field(q, t, x, args):
    return jnp.sum(args["A"][q] * x[None, :], axis=1) + args["b"][q]


def _guard(q, both, t, x, args):
    """Falling where the transition is directed; where it is not of this kind the guard is 1 for ever."""
    h = jnp.sum(args["c"][q] * x[None, :], axis=1) + args["d"][q]
    h = h + args["a"][q] * jnp.sin(args["w"][q] * t + args["p"][q])
    chosen = args["mask"][q] & ((args["dir"][q] == 0) == both)
    return jnp.where(chosen, h if both else -args["dir"][q] * h, 1.0)


def _reset(q, t, x, args, which):
    matrix, shift = args["R"][q][which], args["r"][q][which]
    return jnp.sum(matrix * x[None, :], axis=1) + shift + args["s"][q][which] * jnp.cos(args["u"][q][which] * t)


def _target(q, t, x, args, which):
    return args["tgt"][q][which]
