"""Write the figures of a reproduction in two formats, and its numbers."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["plain", "save"]


def plain(values) -> Any:
    """Nested lists that JSON can hold: −∞ is "-inf", nan is null."""
    if isinstance(values, list | tuple) or np.ndim(values):
        return [plain(value) for value in np.asarray(values).tolist()]
    value = float(values)
    if np.isfinite(value):
        return value
    return None if np.isnan(value) else "-inf" if value < 0 else "inf"


def save(folder: Path, name: str, figures: Mapping[str, Any], data: dict) -> list[Path]:
    """Figures by name as PNG and PDF, and `name`.json; returns the files."""
    files = []
    for title, figure in figures.items():
        files += [folder / f"{title}.{kind}" for kind in ("png", "pdf")]
        figure.savefig(files[-2], dpi=150)
        figure.set_layout_engine("none")  # keep the layout for the second format
        figure.savefig(files[-1])
    files.append(folder / f"{name}.json")
    files[-1].write_text(json.dumps(data, indent=1, allow_nan=False) + "\n")
    return files
