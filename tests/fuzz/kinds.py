"""The kinds of random cases: each a function of seeds that tells what is wrong, by seed."""

from . import arguments, daes, flows, hamiltonians, resets

KINDS = {
    "arguments": arguments.failures,
    "automata": flows.failures,
    "daes": daes.failures,
    "hamiltonians": hamiltonians.failures,
    "resets": resets.failures,
}
