"""How right growth is beside an orbit that grazes, in each decade of impact speeds: ``python -m tests.near_grazing``.

The orbits are those of tests/support/grazing.py, known to 40 digits. Writes tests/near_grazing.json, a list with an
object for each method and decade, from which a page of the site is made; ends with 1 if anything is silently wrong.
"""

import json
import sys
from pathlib import Path

import jax

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))

from grazing import METHODS, STATED, grazing_case, growth_of  # noqa: E402 they are in that folder

TABLE = ROOT / "tests" / "near_grazing.json"
DECADES = range(1, 7)  # d: speeds from 10^(1 - d) down to 10^-d
PARTS, RESTITUTIONS = (5.0, 2.0, 1.0), (1.0, 0.8, 0.3)


def found(name: str, decade: int) -> dict:
    """Of all speeds and restitutions of a decade: how many are noted, the largest error without a note, and with one.

    An error is that of a growth factor, as a part of it; 0 where there is no such case.
    """
    largest, noted, cases = {True: 0.0, False: 0.0}, 0, 0
    for part in PARTS:
        for restitution in RESTITUTIONS:
            said, error = growth_of(grazing_case(part * 10.0**-decade, restitution), METHODS[name])
            largest[said], noted, cases = max(largest[said], error), noted + said, cases + 1
    counts = {"cases": cases, "noted": noted}
    return {"method": name, "decade": decade} | counts | {"without": largest[False], "with": largest[True]}


def main() -> int:
    """All methods and decades."""
    jax.config.update("jax_enable_x64", True)
    rows = [found(name, decade) for name in METHODS for decade in DECADES]
    rounded = [row | {kind: float(f"{row[kind]:.1e}") for kind in ("without", "with")} for row in rows]
    TABLE.write_text("[\n" + ",\n".join(f" {json.dumps(row)}" for row in rounded) + "\n]\n")
    wrong = [row for row in rows if row["without"] > STATED]
    for row in rows:
        print(*row.values())
    print(f"silently wrong in {len(wrong)} of {len(rows)} lines")
    return len(wrong) > 0


if __name__ == "__main__":
    sys.exit(main())
