"""Docstrings of the package explain arguments in running text, `name: meaning; name: meaning`; the site lists them."""

import re
from typing import Any

import griffe

_RAISES = re.compile(r"(?<=[.)]) (?=Raises `)")


class NamedInText(griffe.Extension):
    """Turns the explained arguments and fields of each docstring into a list, and shows the fields of a class."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        _walk(pkg)


def _walk(one: griffe.Object) -> None:
    if one.docstring and (names := _names(one)):
        one.docstring.value = listed(one.docstring.value, names)
    if one.docstring and one.is_class and (fields := _fields(one)):
        one.docstring.value = f"```python\n{one.name}(\n{fields})\n```\n\n{one.docstring.value}"
    for member in one.members.values():
        if not member.is_alias:
            _walk(member)


def _names(one: griffe.Object) -> set[str]:
    """What a docstring may explain: arguments of a function, fields and members of a class."""
    found = {parameter.name for parameter in getattr(one, "parameters", ())}
    return found | (set(one.members) if one.is_class else set())


def _fields(one: griffe.Object) -> str:
    """The arguments of a NamedTuple or dataclass, one on each line."""
    lines = ""
    for member in one.members.values() if "NamedTuple" in map(str, one.bases) or "dataclass" in one.labels else ():
        if member.is_attribute and member.annotation is not None and "property" not in member.labels:
            default = "" if member.value is None else f" = {member.value}"
            lines += f"    {member.name}: {member.annotation}{default},\n"
    return lines


def listed(text: str, names: set[str]) -> str:
    """The text, in which whatever explains one of the names is an item of a list."""
    name = "|".join(sorted(map(re.escape, names), key=len, reverse=True))
    label = re.compile(rf"(?:^|(?<=[.;?)]) )((?:{name})(?:, (?:{name}))*): ")
    return "\n\n".join(_paragraph(part, label) for part in text.split("\n\n"))


def _paragraph(text: str, label: re.Pattern[str]) -> str:
    if text.startswith("    "):
        return text
    before, *rest = label.split(" ".join(text.split("\n")))
    if not rest:
        return text
    items = list(zip(rest[::2], rest[1::2], strict=True))
    last, *after = _RAISES.split(items[-1][1], maxsplit=1)
    items[-1] = (items[-1][0], last)
    named = "\n".join(f"- `{name.replace(', ', '`, `')}`: {meaning.strip().rstrip(';.')}" for name, meaning in items)
    return "\n\n".join(part for part in (before, named, *after) if part)
