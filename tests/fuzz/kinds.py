"""The kinds of random cases: each a function of seeds that tells what is wrong, by seed."""

from . import arguments, calls, daes, flows, hamiltonians, resets

KINDS = {
    "arguments": arguments.failures,
    "automata": flows.failures,
    "calls": calls.failures,
    "daes": daes.failures,
    "hamiltonians": hamiltonians.failures,
    "resets": resets.failures,
}
