"""What Sphinx does not see: raw formulas, broken links within the site, what comes from elsewhere, missing names."""

import functools
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from .pages.reference import TASKS

UNREAD = {"code", "pre", "script", "style", "textarea", "svg"}  # elements whose text may hold anything
VOID = set("area base br col embed hr img input link meta source track wbr".split())
DOLLAR = re.compile(r"\$\$[^$]*\$\$|\$[^\s$][^$\n]{0,200}\$|\\(?:begin|frac|lambda|mathrm)\b")
LOADED = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src"}


class Page(HTMLParser):
    """The text, anchors, links and loaded files of a page."""

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.words, self.anchors, self.links, self.loaded, self.open = [], set(), [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        """Note anchors, links, and whether what follows is prose."""
        found = dict(attrs)
        self.anchors |= {found[key] for key in ("id", "name") if found.get(key)}
        if tag == "a" and found.get("href"):
            self.links.append(found["href"])
        relation = found.get("rel") or ""
        if tag in LOADED and found.get(LOADED[tag]) and (tag != "link" or "stylesheet" in relation):
            self.loaded.append(found[LOADED[tag]])
        if tag not in VOID:
            prose = tag not in UNREAD and "math" not in (found.get("class") or "").split()
            self.open.append((tag, prose and (not self.open or self.open[-1][1])))

    def handle_endtag(self, tag):
        """Close the element, and what was left open within it."""
        for depth in range(len(self.open) - 1, -1, -1):
            if self.open[depth][0] == tag:
                del self.open[depth:]
                return

    def handle_data(self, data):
        """Keep what a reader reads."""
        if not self.open or self.open[-1][1]:
            self.words.append(data)


def faults_of_page(path: Path, page: Page, of) -> list[str]:
    """What is wrong with a page; `of` gives the pages by their paths."""
    found = [f"{path}: a formula that is not drawn: {raw[:60]!r}" for raw in DOLLAR.findall(" ".join(page.words))]
    for link in page.links + page.loaded:
        parts = urlsplit(link)
        if parts.scheme or parts.netloc:
            continue
        target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        if not target.exists():
            found.append(f"{path}: no such file: {link}")
        elif parts.fragment and target.suffix == ".html" and unquote(parts.fragment) not in of(target).anchors:
            found.append(f"{path}: no such place: {link}")
    outside = [link for link in page.loaded if urlsplit(link).netloc]
    return found + [f"{path}: loads {link} from elsewhere" for link in outside]


def missing_names(html: Path) -> list[str]:
    """Public names that have no page."""
    wanted = [f"{task.module}.{name}" for task in TASKS.values() for name in task.names]
    return [name for name in wanted if not (html / "reference" / "api" / f"{name}.html").exists()]


def faults(html: Path) -> list[str]:
    """All that is wrong with the pages in a folder."""
    of = functools.cache(lambda path: Page(path.read_text()))
    found = []
    for path in sorted(html.resolve().rglob("*.html")):
        if "_static" not in path.parts:
            found += faults_of_page(path, of(path), of)
    return found + [f"no page for {name}" for name in missing_names(html)]
