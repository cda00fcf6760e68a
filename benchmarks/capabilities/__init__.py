"""One closing table: capability, truth, error found, cost."""

from types import ModuleType

from benchmarks.capabilities import (
    basins,
    curves,
    engineering,
    fields,
    neurons,
    noise,
    phases,
    synchronisation,
)

CAPABILITIES: dict[str, ModuleType] = {
    "synchronisation": synchronisation,
    "phases": phases,
    "basins": basins,
    "curves": curves,
    "noise": noise,
    "neurons": neurons,
    "fields": fields,
    "engineering": engineering,
}
