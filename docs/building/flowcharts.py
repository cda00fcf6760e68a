"""The directive `flowchart`: questions from the top down, each with the answer for yes.

Each line of its content is ``question => answer``; the last one has no question. Both are Markdown.
"""

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective


class Flowchart(SphinxDirective):
    """Boxes in two columns: a question, an arrow, an answer; below the question the way to the next."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """The boxes of all lines."""
        chart = nodes.container(classes=["flowchart"])
        lines = [line for line in self.content if line.strip()]
        for number, line in enumerate(lines):
            question, arrow, answer = line.partition("=>")
            if not arrow:
                raise self.error(f"A line of a flowchart is 'question => answer'; got {line!r}.")
            if question.strip():
                chart += self.box("question", question)
                chart += self.box("yes", "yes →")
                chart += self.box("answer", answer)
                chart += self.box("no", "no ↓" if number < len(lines) - 1 else "")
            else:
                chart += self.box("answer last", answer)
        return [chart]

    def box(self, kind: str, text: str) -> nodes.container:
        """A box with a line of Markdown."""
        box = nodes.container(classes=kind.split())
        self.state.nested_parse(StringList([text.strip()], source=""), self.content_offset, box)
        return box
