"""Films in the gallery: their buttons take the icons of the theme, not a style sheet from elsewhere."""

import re

ICONS = re.compile(r'<link rel="stylesheet"\s+href="https?://[^"]*font-awesome[^"]*">')


def own_icons(app, pagename, templatename, context, doctree) -> None:
    """Remove matplotlib's link to icons (event html-page-context)."""
    if "body" in context:
        context["body"] = ICONS.sub("", context["body"])
