"""The pages of the reference, from the package itself: its public names, and every setting with its default."""

import ast
import inspect
import io
import tokenize
from collections.abc import Iterator

import pgrssnn_jax
from pgrssnn_jax import effects, physics
from pgrssnn_jax.discovery.settings import Criteria, DiscoverySettings
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.training.settings import DataSettings, FitSettings, MemberSettings, RunSettings

#: title, prefix on the command line, class
SETTINGS = (
    ("Model", "model.", ModelSpec),
    ("Optimisation", "fit.", FitSettings),
    ("Members and starts of records", "", RunSettings),
    ("Use of the records", "data.", DataSettings),
    ("Mapping of members", "members.", MemberSettings),
    ("Discovery", "discovery.", DiscoverySettings),
)
ROOMS = ("physics", "effects")


def reference_pages() -> dict[str, str]:
    """Name of each page and its text."""
    public = [name for name in pgrssnn_jax.__all__ if name not in ROOMS]
    return {
        "reference/api.md": _names("Python API", "import pgrssnn_jax as pg", "pg", "pgrssnn_jax", public),
        "reference/physics.md": _names("Physics", "pg.physics", "pg.physics", "pgrssnn_jax.physics", physics.__all__),
        "reference/effects.md": _names("Effects", "pg.effects", "pg.effects", "pgrssnn_jax.effects", effects.__all__),
        "reference/settings.md": _settings(),
    }


def _names(title: str, code: str, short: str, module: str, names: list[str]) -> str:
    entries = (
        f'::: {module}.{name}\n    options:\n      heading: "{short}.{name}"\n      toc_label: "{name}"\n'
        for name in names
    )
    return "\n".join((f"# {title}\n\n`{code}`\n", *entries))


def _settings() -> str:
    opening = (
        "# Settings\n\nEvery setting of training and discovery, made from the dataclasses that hold the defaults. "
        "`pg.fit` and `pg.discover` take a setting by its name (`epochs=200`), the commands by group and name "
        "(`fit.epochs=200`).\n"
    )
    parts = [f"## {title}\n\n{_table(prefix, kind)}" for title, prefix, kind in SETTINGS]
    return "\n".join(
        (opening, *parts, f"## Criteria of discovery\n\n{inspect.getdoc(Criteria)}\n\n{_table('', Criteria)}")
    )


def _table(prefix: str, kind: type) -> str:
    rows = [f"| `{prefix}{name}` | {_code(default)} | {said} |" for name, default, said in _fields(kind)]
    return "\n".join(("| setting | default | meaning, unit, source |", "|---|---|---|", *rows, ""))


def _code(text: str) -> str:
    return f"`{text}`".replace("|", "\\|")


def _fields(kind: type) -> Iterator[tuple[str, str, str]]:
    """Name, default and comment of each field, as its source states them."""
    source = inspect.getsource(kind)
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    (definition,) = ast.parse(source).body
    for field in definition.body:
        if isinstance(field, ast.AnnAssign):
            shown = getattr(kind(), field.target.id)
            choices = ast.unparse(field.annotation)
            said = comments.get(field.end_lineno, "")
            if choices.startswith("Literal["):
                said = f"{choices.removeprefix('Literal[').removesuffix(']')}" + (f": {said}" if said else "")
            yield field.target.id, repr(shown), said.replace("|", "\\|")
