"""Models with events of the SBML semantic test suite.

https://github.com/sbmlteam/sbml-test-suite, cases/semantic/NNNNN: equations, starts, conditions, assignments, written
here by hand. Amounts and concentrations are those of the table's columns; sizes of compartments are in the constants.
"""

from sbml_events import Event, Model

_ONE = ["1: S1 -> S2"]
_BINDING = ["0.75: S1 + S2 -> S3", "0.25: S3 -> S1 + S2"]
_RING = ["0.75: S1 -> S2", "0.55: S2 -> S3", "0.25: S3 -> S1"]
_TURN = ["0.9: S1 -> S2", "0.075: S2 -> S1"]
_TWO_TURNS = [*_TURN, "0.75: S3 -> S4", "0.15: S4 -> S3"]
_GROWTH = ["0.375: -> S3", "-0.125: -> S4"]
_FULL, _HALVES = {"S1": 1.0, "S2": 0.0}, {"S1": 1.0, "S2": 2.0}
_THREE, _FOUR = {"S1": 1.0, "S2": 2.0, "S3": 1.0}, {"S1": 1.0, "S2": 2.0, "S3": 1.0, "S4": 1.5}


def _exchange(size, forth=0.75, back=0.25, products="S3 + S4"):
    """S1 + S2 to two products and back; all quantities have a size, the constants its inverse."""
    start = {"S1": size, "S2": 1.2 * size, "S3": 2 * size, "S4": size}
    return start, [f"{forth / size}: S1 + S2 -> {products}", f"{back / size}: {products} -> S1 + S2"]


# --- conditions on quantities ----------------------------------------------------------------------------------------

LOW, HIGH = "S1 < 0.1", "S2 > 0.5"
FLOWING = {
    "00026": Model(_FULL, _ONE, [Event(LOW, {"S1": "1"})]),
    "00041": Model(_FULL, _ONE, [Event(LOW, {"S1": "1"}), Event(HIGH, {"S2": "0"})]),
    "00071": Model(_FULL, _ONE, [Event(LOW, {"S1": "1"}, delay=1)]),
    "00072": Model(_FULL, _ONE, [Event(LOW, {"S1": "1"}, delay=1), Event(HIGH, {"S2": "0"}, delay=0.5)]),
    "00073": Model(_FULL, _ONE, [Event(LOW, {"S1": "1", "S2": "0"}, delay=1)]),
    "00074": Model(_FULL, _ONE, [Event(LOW, {"S1": "1", "S2": "0"})]),
    "00348": Model(_THREE, _BINDING, [Event("S1 < 0.75", {"S2": "1"})]),
    "00349": Model(_THREE, _BINDING, [Event("S1 < 0.75", {"S2": "1"}), Event("S3 > 1.4", {"S1": "1"})]),
    "00350": Model(_THREE, _BINDING, [Event("S1 < 0.75", {"S1": "1", "S2": "1.5"})]),
    "00351": Model(*_exchange(1e-3), [Event("S4 > S2", {"S1": "0.002"})]),
    "00352": Model(*_exchange(1e-2), [Event("S4 > S2", {"S1": "0.02"}), Event("S3 > 0.0225", {"S4": "0.01"})]),
    "00353": Model(*_exchange(0.1), [Event("S4 > S2", {"S1": "0.2", "S4": "0.05"})]),
    "00369": Model(_THREE, ["7.5: S1 + S2 -> S3", "0.25: S3 -> S1 + S2"], [Event("S1 < 0.075", {"S2": "0.1"})]),
    "00374": Model(
        {"S1": 4e-4, "S2": 4.8e-4, "S3": 8e-4, "S4": 4e-4},
        ["7500: S1 + S2 -> S3 + S4", "250: S3 + S4 -> S1 + S2"],
        [Event("S4 > S2", {"S1": "0.0002", "S4": "0.0002"})],
    ),
    "00375": Model(_THREE, ["0.75: S1 + S2 -> S3 + S2", "0.25: S3 -> S1"], [Event("S1 < 0.75", {"S2": "1"})]),
    "00387": Model(_THREE, ["0.75: S1 + 2 S2 -> S3", _BINDING[1]], [Event("S1 < 0.75", {"S2": "1"})]),
    "00399": Model(_THREE, _BINDING, [Event("S1 < 0.75", {"S1": "S2", "S2": "1.5"})]),
    "00400": Model(_THREE, _RING, [Event("S1 < 0.75", {"S1": "S2", "S2": "1.5"})]),
    "00401": Model(_THREE, _RING, [Event("S1 < 0.75", {"S1": "S2", "S2": "S3", "S3": "S1"})]),
    "00405": Model(_THREE, _BINDING, [Event("S1 < 0.75", {"S2": "1"}, delay=1)]),
    "00406": Model(
        _THREE,
        _BINDING,
        [Event("S1 < 0.75", {"S2": "1"}, delay=1), Event("S3 > 1.4", {"S1": "1"}, delay=0.25)],
    ),
    "00407": Model(_THREE, _BINDING, [Event("S1 < 0.75", {"S1": "1", "S2": "1.5"}, delay=2)]),
    "00409": Model(
        *_exchange(1e-3),
        [Event("S4 > S2", {"S1": "0.002"}, delay=0.5), Event("S3 > 0.00225", {"S4": "0.001"}, delay=0.75)],
    ),
    "00410": Model(*_exchange(1e-2), [Event("S4 > S2", {"S1": "0.02", "S4": "0.005"}, delay=1.2)]),
    "00444": Model(_THREE, ["0.75: S1 + 2 S2 -> S3", _BINDING[1]], [Event("S1 < 0.75", {"S2": "1"}, delay=1.9)]),
    "00447": Model(
        *_exchange(1e-2, products="2 S3 + S4"),
        [Event("S4 > S2", {"S1": "0.02"}, delay=0.5), Event("S3 > 0.025", {"S4": "0.01"}, delay=1.5)],
    ),
    "00456": Model(_THREE, _BINDING, [Event("S1 < 0.75", {"S1": "S2", "S2": "1.5"}, delay=2)]),
    "00457": Model(_THREE, _RING, [Event("S1 < 0.75", {"S1": "S2", "S2": "1.5"}, delay=1.5)]),
    "00458": Model(_THREE, _RING, [Event("S1 < 0.75", {"S1": "S2", "S2": "S3", "S3": "S1"}, delay=1.5)]),
    "00646": Model({"S1": 1.5, "S2": 0, "S3": 0}, ["1.5: S1 -> S2", "0.15: -> S3"], [Event("S1 < 0.1", {"S2": "1"})]),
    "00647": Model(
        {"S1": 1.5, "S2": 2, "S3": 1.5, "S4": 1},
        ["0.75: S1 + S2 -> S3", "0.00025: S3 -> S1 + S2", "1: -> S4"],
        [Event("S1 < 0.5", {"S2": "2"})],
    ),
    "00648": Model(
        {"S1": 1.5, "S2": 2, "S3": 1.5, "S4": 4}, ["0.75: S1 -> S2", *_GROWTH], [Event("S1 < 0.5", {"S2": "2"})]
    ),
    "00723": Model(
        {"S1": 1.5, "S2": 2, "S3": 1.5, "S4": 4}, ["0.75: S1 -> 2 S2", *_GROWTH], [Event("S1 < 0.5", {"S2": "2"})]
    ),
    "00774": Model(_THREE, _BINDING, [Event("S1 < 0.75", {"S2": "1"}), Event("S3 > 1.4", {"S1": "1"}, delay=0.25)]),
    "00775": Model(
        *_exchange(1e-2), [Event("S4 > S2", {"S1": "0.02"}), Event("S3 > 0.0225", {"S4": "0.01"}, delay=0.75)]
    ),
    "00776": Model(
        _THREE,
        _BINDING,
        [Event("S1 < 0.75", {"S1": "1", "S2": "1.5"}, delay=2), Event("S3 > 1.75", {"S3": "1.5"})],
    ),
    "00845": Model(_HALVES, _TURN, [Event("S1 < 0.75", {"S2": "1.5"})]),
    "00846": Model(_FOUR, _TWO_TURNS, [Event("S1 < 0.5", {"S2": "1.5", "S4": "S2"})]),
    "00847": Model(_FOUR, _TWO_TURNS, [Event("S1 < 0.5", {"S2": "1.5"}), Event("S3 < 0.75", {"S4": "0.5"})]),
    "00848": Model(_HALVES, _TURN, [Event("S1 < 0.75", {"S2": "1.5"}, delay=1)]),
    "00849": Model(_FOUR, _TWO_TURNS, [Event("S1 < 0.5", {"S2": "1.5", "S4": "S2"}, delay=1.89)]),
    "00850": Model(
        _FOUR,
        _TWO_TURNS,
        [Event("S1 < 0.5", {"S2": "1.5"}, delay=2), Event("S3 < 0.75", {"S4": "0.5"}, delay=2.5)],
    ),
    "00883": Model(_THREE, _BINDING, [Event("S1 < 0.5", {"S2": "time"})]),
    "00884": Model(_THREE, _BINDING, [Event("S1 < 0.75", {"S2": "4 time"}), Event("S3 > 1.4", {"S1": "0.25 time"})]),
    "01227": Model({"S1": 0, "k1": 1.5}, ["1: k1 -> k1 + S1"], [Event("time > k1", {"k1": "2"})]),
    "01324": Model({"x": 1, "y": 0}, ["1: -> x"], [Event("x >= 3.5", {"y": "x"}, delay=2)]),
    "01325": Model({"x": 1, "y": 0}, ["1: -> x"], [Event("x >= 3.5", {"y": "x"}, delay=2, at_trigger=False)]),
    "01340": Model({"S1": 0, "k1": 1}, ["1: k1 -> k1 + S1"], [Event("time > 5.5", {"k1": "-1"})]),
}

# --- several events at one instant, at the start, cancelled -----------------------------------------------------------

_CLOCK, _BOTH = "time >= 0.99", "x > 2"
TOGETHER = {
    "00928": Model({"S1": 0, "S2": 0}, _ONE, [Event("time >= 0", {"S1": "0.00015"}, initially=False)]),
    "00929": Model({"S1": 1.5e-4, "S2": 0}, _ONE, [Event("time >= 0", {"S1": "1"})]),
    "00930": Model(
        {"S1": 0, "S2": 0, "S3": 0},
        [],
        [Event(_CLOCK, {"S1": "4", "S2": "5", "S3": "6"}), Event(_CLOCK, {"S1": "1", "S2": "2", "S3": "3"})],
    ),
    "00931": Model(
        {"S1": 0, "S2": 0, "S3": 0},
        [],
        [Event("time >= 1", {"S1": "1", "S2": "2", "S3": "3"}), Event("time >= 1", {"S1": "4", "S2": "5", "S3": "6"})],
    ),
    "00932": Model(
        {"S1": 1.5e-4, "S2": 1.5e-4, "S3": 1.5e-4},
        _ONE,
        [Event("S1 <= 0.00005 and S1 >= 0.00004", {"S3": "0.00025"}, delay=3, persistent=False)],
    ),
    "00935": Model(
        {"S1": 0, "S2": 1},
        [],
        [
            Event(f"{_CLOCK} and S1 < 0.5", {"S1": "1", "S2": "0"}),
            Event(f"{_CLOCK} and S1 < 0.5", {"S1": "3", "S2": "2"}),
            Event(f"{_CLOCK} and S1 < 0.5", {"S1": "2", "S2": "1"}, persistent=False),
        ],
    ),
    "00963": Model(  # the first of its two pairs
        {"Q": 0, "R": 0, "reset": 0},
        [],
        [
            Event("time - reset >= 0.01", {"reset": "time", "Q": "Q + 0.01"}, persistent=False),
            Event("time - reset >= 0.01", {"reset": "time", "R": "R + 0.01"}, persistent=False),
        ],
    ),
    "00979": Model(
        {"x": 0, "y": 0, "p": 0, "q": 0},
        [],
        [Event("time >= 0.98", {"y": "y + x", "x": "2"}), Event(_CLOCK, {"p": "3", "q": "p + 1"})],
    ),
    "00980": Model(
        {"x": 0, "y": 0, "p": 0, "q": 0},
        [],
        [
            Event("time >= 0.98", {"y": "y + x", "x": "2"}, delay=0.1, at_trigger=False),
            Event(_CLOCK, {"p": "3", "q": "p + 1"}, delay=0.1, at_trigger=False),
        ],
    ),
    "00995": Model(
        {"p1": 1, "p2": 0, "p3": 0}, [], [Event("p1 > 0", {"p2": "1"}, initially=False), Event("p1 > 0", {"p3": "1"})]
    ),
    "01119": Model(
        {"e1": 0, "e2": 0},
        [],
        [
            Event("time >= 3", {"e1": "3"}, delay=1.5),
            Event("time >= 3", {"e2": "2"}, delay=1.5),
            Event("time >= 3", {"e1": "2"}, delay=1.5),
            Event("time >= 3", {"e2": "3"}, delay=1.5),
        ],
    ),
    "01328": Model({"x": 1, "y": 0}, [], [Event("time > 3.5", {"x": "7"}), Event("time > 2.5", {"y": "x"}, delay=2)]),
    "01329": Model(
        {"x": 1, "y": 0},
        [],
        [Event("time > 3.5", {"x": "7"}), Event("time > 2.5", {"y": "x"}, delay=2, at_trigger=False)],
    ),
    "01330": Model({"x": 3, "y": 0}, [], [Event("time > 3.5", {"x": "7"}), Event("time > 3.5", {"y": "x"})]),
    "01331": Model(
        {"x": 3, "y": 0}, [], [Event("time > 3.5", {"x": "7"}), Event("time > 3.5", {"y": "x"}, at_trigger=False)]
    ),
    "01332": Model(
        {"x": 3}, [], [Event(_BOTH, {"x": "7"}, initially=False), Event(_BOTH, {"x": "5"}, initially=False)]
    ),
    "01333": Model(
        {"x": 3, "y": 0}, [], [Event(_BOTH, {"x": "7"}, initially=False), Event(_BOTH, {"y": "x"}, initially=False)]
    ),
    "01334": Model(
        {"x": 3, "y": 0},
        [],
        [
            Event(_BOTH, {"x": "7"}, initially=False),
            Event(_BOTH, {"y": "x"}, initially=False, at_trigger=False),
        ],
    ),
    "01335": Model({"x": 3}, [], [Event(_BOTH, {"x": "7"}, initially=False, delay=2.5)]),
    "01336": Model(
        {"x": 3, "y": 6},
        [],
        [Event(_BOTH, {"x": "0"}, initially=False), Event(_BOTH, {"y": "7"}, initially=False, persistent=False)],
    ),
    "01337": Model(
        {"x": 3, "y": 6}, [], [Event(_BOTH, {"x": "0"}, initially=False), Event(_BOTH, {"y": "7"}, initially=False)]
    ),
    "01758": Model(
        {"P1": 1.5},
        [],
        [
            Event("P1 > 1", {"P1": "3"}, initially=False, delay=2.3),
            Event("P1 > 1", {"P1": "0"}, initially=False, delay=1.5),
        ],
    ),
    "01759": Model(
        {"P1": 0.5},
        [],
        [
            Event("P1 > 1", {"P1": "3"}, delay=2),
            Event("P1 > 1", {"P1": "0"}, delay=1),
            Event("time > 0.65", {"P1": "2"}),
        ],
    ),
    "01798": Model(
        {"P1": 0, "P2": 0},
        ["1: -> P1", "1: -> P2"],
        [
            Event("P1 >= 1.5", {"P1": "P1"}, delay=2),
            Event("P2 >= 1.5", {"P2": "P2"}, delay=2, at_trigger=False),
        ],
    ),
}
MODELS = FLOWING | TOGETHER
