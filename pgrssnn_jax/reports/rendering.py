"""Pages and their parts filled in from the templates beside this file; everything that they are given is escaped."""

import base64
import json
from functools import cache
from pathlib import Path
from typing import Any

from pgrssnn_jax.reports import content

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def rendered(template: str, **given: Any) -> str:
    """Templates know `content` beside what they are given. Raises `ValueError` for a picture that is no PNG file."""
    return _templates().get_template(template).render(**given)


@cache
def _templates() -> Any:
    """Loaded with the first page: a command that writes none does not wait for it."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("pgrssnn_jax", "reports")
    made = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined)
    made.globals["content"] = content
    made.filters |= {"number": content.number, "percent": content.percent, "duration": content.duration}
    made.filters |= {"png": _png, "json": lambda tree: json.dumps(tree, indent=2, default=str)}
    return made


def _png(picture: Path | bytes) -> str:
    """A PNG file as an address that holds it."""
    raw = picture if isinstance(picture, bytes) else picture.read_bytes() if picture.is_file() else b""
    if not raw.startswith(PNG_SIGNATURE):
        raise ValueError(f"report: figures: expected a PNG file, found {picture!s:.200}")
    return f"data:image/png;base64,{base64.b64encode(raw).decode('ascii')}"
