"""Build the site into build/site/html, strictly and offline: `python -m docs [--no-pictures] [--fresh]`.

Any warning is an error. Afterwards the pages are read again: no raw formulas, no broken links, every public name there.
"""

import argparse
import shutil
import sys
from pathlib import Path

from sphinx.cmd.build import build_main

from .building import assembling, checks

ROOT = Path(__file__).parents[1]
SITE = ROOT / "build" / "site"


def main() -> int:
    """Assemble the pages, build them, check what came out."""
    parser = argparse.ArgumentParser(prog="python -m docs", description=__doc__.splitlines()[0])
    parser.add_argument("--no-pictures", action="store_true", help="do not run the gallery; into build/site/plain")
    parser.add_argument("--fresh", action="store_true", help="forget what was built before")
    options = parser.parse_args()
    site = SITE / "plain" if options.no_pictures else SITE  # apart: stand-ins for pictures would stay
    source, html = site / "source", site / "html"
    if options.fresh:
        shutil.rmtree(site, ignore_errors=True)
    assembling.assemble(ROOT, source)
    asked = ["-b", "html", "-W", "--keep-going", "-q", "-c", str(ROOT / "docs"), "-d", str(site / "doctrees")]
    pictures = ["-D", "plot_gallery=0"] if options.no_pictures else []
    if build_main([*asked, *pictures, str(source), str(html)]):
        return 1
    faults = checks.faults(html)
    print(*faults, sep="\n", file=sys.stderr)
    print(f"{html / 'index.html'}: {len(list(html.rglob('*.html')))} pages, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
