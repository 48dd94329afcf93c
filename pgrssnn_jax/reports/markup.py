"""HTML with everything escaped: elements, figures, and the frame that all pages share.

A page is one file that loads nothing: images are embedded, and its policy forbids everything else.
"""

import base64
import json
from collections.abc import Iterable, Mapping
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
STYLESHEET = resources.files("pgrssnn_jax.reports").joinpath("page.css").read_text(encoding="utf-8")
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


class Markup(str):
    """Text that is HTML already; all other text is escaped on its way into a page."""

    __slots__ = ()


Content = str | tuple[Any, ...]
"""Text, HTML, or a sequence of such pieces."""


def html(content: Content) -> Markup:
    """Content as HTML: text is escaped."""
    if isinstance(content, Markup):
        return content
    return Markup(escape(content) if isinstance(content, str) else "".join(map(html, content)))


def tag(name: str, *content: Content, look: str = "", **attributes: str) -> Markup:
    """An element; `look` is its class, and an empty attribute is left out."""
    given = {"class": look, **attributes}
    named = "".join(f' {key.replace("_", "-")}="{escape(value)}"' for key, value in given.items() if value)
    return Markup(f"<{name}{named}>{html(content)}</{name}>")


def bullets(items: Iterable[Content], look: str = "") -> Markup:
    return tag("ul", *(tag("li", item) for item in items), look=look)


def banner(loud: str, *text: Content) -> Markup:
    """What nobody may overlook."""
    return tag("div", tag("strong", f"{loud}."), " ", *text, look="banner", role="alert")


def card(name: str, value: Content, note: str) -> Markup:
    return tag("div", tag("dt", name), tag("dd", value, tag("small", note)), look="card")


def folded(title: str, content: Content) -> Markup:
    """Content behind a heading that opens it; text is preformatted."""
    return tag("details", tag("summary", title), content if isinstance(content, Markup) else tag("pre", content))


def image(path: Path, alt: str) -> Markup:
    """A PNG file as an element that holds the file itself."""
    raw = path.read_bytes() if path.is_file() else b""
    if not raw.startswith(PNG_SIGNATURE):
        raise ValueError(f"report: figures: expected a PNG file, found {path}")
    source = f"data:image/png;base64,{base64.b64encode(raw).decode('ascii')}"
    return Markup(f'<img alt="{escape(alt)}" src="{source}">')


def figure(picture: Markup, title: str, caption: str, **attributes: str) -> Markup:
    """A picture above its title and caption."""
    return tag("figure", picture, tag("figcaption", tag("strong", f"{title}."), " ", caption), **attributes)


def numbered_figure(k: int, path: Path, title: str, caption: str) -> Markup:
    return figure(image(path, title), f"Figure {k}. {title}", caption, id=f"figure-{k}")


def reproduce(config_text: str, environment: Mapping[str, Any]) -> Markup:
    """The commands that repeat a run, the configuration and the environment it had."""
    commit, command = environment.get("commit"), environment.get("command")
    steps = [*([f"git checkout {str(commit).removesuffix('+changes')}"] if commit else []), str(command or "")]
    return html(
        (
            tag("h2", "Reproduce", id="reproduce"),
            tag("pre", "\n".join(steps).strip()),
            folded("Configuration: config.yaml", config_text),
            folded("Environment: environment.json", json.dumps(environment, indent=2, default=str)),
        )
    )


def document(
    *,
    kind: str,
    title: str,
    heading: str,
    facts: Iterable[str],
    banners: Iterable[Markup],
    cards: Iterable[Markup],
    links: Mapping[str, str],
    sections: Iterable[Markup],
    footer: str,
    lead: str = "",
    look: str = "",
) -> str:
    """A whole page. kind: what it reports on; links: anchor → text of the index; look: class of the page."""
    words, known = (tag("p", text, look=of) for text, of in ((lead, "lead"), (" · ".join(facts), "facts")))
    anchors = (tag("a", text, href=f"#{anchor}") for anchor, text in links.items())
    parts = [
        tag("header", tag("p", kind, look="eyebrow"), tag("h1", heading), words if lead else "", known),
        *banners,
        tag("dl", *cards, look="cards"),
        tag("nav", bullets(anchors), aria_label="Contents"),
        *sections,
        tag("footer", footer),
    ]
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
{tag("title", title)}
<style>
{STYLESHEET}</style>
</head>
<body>
{tag("main", Markup(chr(10).join(parts)), look=look)}
</body>
</html>
"""
