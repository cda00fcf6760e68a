"""STATUS: how a run ended. A failure in mid-run is returned as data, not raised."""

import enum
from collections import Counter
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from ._jax.tracing import numpy_for, traced

__all__ = ["OK", "RUNNING", "STATUS", "STIFF_REMEDY", "gravest", "nan_if_failed", "nan_where", "status_of", "verdicts"]

STIFF_REMEDY = "lh.RadauIIA(), and for several exponents lh.ContinuousQR(lh.RadauIIA())"


class STATUS(enum.IntEnum):
    """How a run ended. ``str(status)`` is the name and its meaning."""

    meaning: str  # its meaning, likely causes and cures

    ok = 0, "the run reached its end"
    terminated = 1, "a terminal transition ended the run"
    max_steps = 2, "max_steps attempts were made before the end; raise max_steps or loosen the tolerances"
    zeno = (
        3,
        "events accumulate: (a) the motion itself has infinitely many jumps in finite time, as a ball that comes "
        "to rest; end the run with a terminal transition, or give the rest a mode of its own, as the page on "
        "accumulating events shows for a table that moves; (b) a cascade went "
        "beyond max_cascade, resets that throw the state from guard to guard, or modes that change to and fro: a guard "
        "that is beyond zero where its mode is entered fires at once, as in a hysteresis with exchanged thresholds; "
        "(c) more units than max_cascade of lh.Hybrid fire at one instant, as neurons in an avalanche: raise it",
    )
    deadlock = (
        4,
        "neither flow nor jump is possible: (a) at the start or after a reset the state rests on a guard and is "
        "pushed through it, as a body that lies on a floor: a contact that lasts needs a mode of its own; (b) every "
        "`when` of the transitions that share the guard said no; (c) repelling sliding, or a two-fold: "
        "lh.solutions follows each way on; (d) a target is no mode's index; (e) a slide of lh.filippov meets another "
        "surface: it needs modes of your own, in an lh.Hybrid",
    )
    nonfinite = (
        5,
        "the state became infinite or nan: (a) the solution escapes; (b) a user function divides by zero or takes "
        "a root of a negative number near this state; (c) a fixed step dt is too long: halve it; "
        "(d) a parameter is nan; (e) with an lh.Schedule, perturbations meet an event that a jump brought about: give "
        "next_event instead; (f) a guard is infinite or nan: give a large number for an event that cannot come",
    )
    inconsistent_start = (
        6,
        "the start does not satisfy the algebraic equations; make it with lh.consistent_start(dae, x0, args, t0=…)",
    )
    singular_dae = (
        7,
        "[E₁; ∂f₂/∂x] became singular, or a row of E that should be zero did not stay so: (a) the solution ends there; "
        "(b) the rank of E, or of ∂F/∂x' of an lh.implicit_dae, changes: build it with the args of the run; "
        "(c) a hidden constraint, the differentiation index is above one",
    )
    constraint_drift = (
        8,
        "the state has left the algebraic equations: (a) take lh.HalfExplicit or lh.ESDIRK, which keep them in each "
        "step; (b) tighten the tolerances",
    )
    step_underflow = (
        9,
        "the step size went below the resolution of the time: (a) the field jumps, give each smooth piece a mode; "
        f"(b) the flow is stiff, use {STIFF_REMEDY}; (c) the tolerances are below rounding",
    )
    interrupted = 10, "Ctrl-C ended the run; what was computed until then is kept"
    stalled = (
        11,
        "many steps lead nowhere: (a) the field jumps (where, sign, floor), give each smooth piece a mode; (b) a guard "
        f"jumps (mod), use a clock, Transition(every=…); (c) the flow is stiff, use {STIFF_REMEDY}; "
        "(d) a guard or a section is never reached; (e) t1 is very far; max_steps=… goes on all the same; (f) "
        "target_stderr is out of reach",
    )
    no_more_jumps = (
        12,
        "the run was to end by its number of jumps, or of crossings of a section, but the flow does not come to that "
        "guard again: (a) it has settled to an equilibrium; (b) it leaves for ever; (c) there was none in a million "
        "steps. Exponents are those up to the last jump; for those of the flow after it use clock='time'",
    )

    no_orbit = (
        13,
        "no periodic orbit was found: (a) the start is too far from one, give a transient; (b) there is none, the "
        "motion rests, leaves for ever or does not repeat; (c) the orbit is unstable and long, give segments",
    )

    def __new__(cls, code: int, meaning: str):
        """Make a member from its code and its meaning."""
        member = int.__new__(cls, code)
        member._value_, member.meaning = code, meaning
        return member

    def __str__(self) -> str:
        return f"{self.name}: {self.meaning}"

    @property
    def failed(self) -> bool:
        """Whether the run failed: it stopped early, and neither a terminal transition nor the user ended it."""
        return self not in (STATUS.ok, STATUS.terminated, STATUS.interrupted)


def gravest(codes):
    """The code of the gravest status of one or several runs: failures are graver than early ends."""
    xp = numpy_for(codes)
    return xp.asarray(BY_GRAVITY)[xp.max(xp.asarray(GRAVITY)[codes])]


def status_of(codes):
    """The gravest status of one or several runs; under a JAX transformation its integer code."""
    code = gravest(codes)
    return code if traced(code) else STATUS(int(code))


def nan_if_failed(codes, result, *names: str):
    """The result with nan in these fields if the gravest status of its runs is a failure.

    For results under a JAX transformation, where nothing can be raised and a field may be all that is kept.
    """
    return nan_where(jnp.asarray(IS_FAILURE)[gravest(codes)], result, *names)


def nan_where(wrong, result, *names: str):
    """The result with nan in these fields where it is wrong ()."""
    return replace(result, **{name: jnp.where(wrong, jnp.nan, getattr(result, name)) for name in names})


def verdicts(codes) -> str:
    """Number of runs with each status, as in ``5 ok, 2 zeno, 1 nonfinite``."""
    counts = Counter(int(code) for code in np.ravel(codes))
    return ", ".join(f"{count} {STATUS(code).name}" for code, count in sorted(counts.items()))


RUNNING = 0
OK = 0

# Less grave than all other statuses, in increasing order.
ENDED = (STATUS.ok, STATUS.terminated, STATUS.interrupted, STATUS.max_steps, STATUS.stalled)
BY_GRAVITY = np.array([*ENDED, *(code for code in STATUS if code not in ENDED)], np.int32)
IS_FAILURE = np.array([STATUS(code).failed for code in range(max(STATUS) + 1)])
GRAVITY = np.zeros(max(STATUS) + 1, np.int32)  # rank of each code
GRAVITY[BY_GRAVITY] = np.arange(len(BY_GRAVITY))
