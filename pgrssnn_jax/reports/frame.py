"""What all pages share: the document around the sections, the index, the cards, figures with their captions.

A page is one file that loads nothing: images are embedded, and its policy forbids everything else.
"""

from collections.abc import Iterable, Mapping
from html import escape

from pgrssnn_jax.reports.stylesheet import STYLESHEET

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def document(title: str, sections: Iterable[str], footer: str, style: str = "") -> str:
    """A whole page; `sections` are markup already, `title` and `footer` are text, `style` adds to the style sheet."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<title>{escape(title)}</title>
<style>{STYLESHEET}{style}</style>
</head>
<body>
<main>
{"".join(sections)}
<footer>{escape(footer)}</footer>
</main>
</body>
</html>
"""


def index(links: Mapping[str, str]) -> str:
    """anchor → text."""
    items = "".join(f'<li><a href="#{anchor}">{escape(text)}</a></li>' for anchor, text in links.items())
    return f'<nav aria-label="Contents"><ul>{items}</ul></nav>\n'


def cards(items: Iterable[tuple[str, str, str]]) -> str:
    """Each card is a name, a value that is markup already, and a note."""
    shown = (
        f'<div class="card"><dt>{escape(name)}</dt><dd>{value}<small>{escape(note)}</small></dd></div>'
        for name, value, note in items
    )
    return f'<dl class="cards">{"".join(shown)}</dl>\n'


def shown_figure(anchor: str, look: str, picture: str, title: str, caption: str) -> str:
    """A picture, which is markup already, above its title and caption."""
    named = "".join(f' {name}="{value}"' for name, value in (("id", anchor), ("class", look)) if value)
    words = f"<strong>{escape(title)}.</strong> {escape(caption)}"
    return f"<figure{named}>{picture}<figcaption>{words}</figcaption></figure>\n"
