"""What MkDocs does beside converting docs/*.md: pages of other folders, notebooks, the reference, and links to them.

Files outside docs/ become pages of the site, so that one link serves a reader of the repository and of the site.
"""

import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbconvert import MarkdownExporter
from reference import reference_pages

ROOT = Path(__file__).parents[2]
#: files of the repository that are pages of the site
PAGES = {
    "README.md": "index.md",
    "runs/README.md": "run_folder.md",
    "CHANGELOG.md": "changes.md",
    "pgrssnn_jax/discovery/settings.py": "reference/settings.md",
    "pgrssnn_jax/training/settings.py": "reference/settings.md",
    "pgrssnn_jax/models/spec.py": "reference/settings.md",
    "pgrssnn_jax/effects": "reference/effects.md",
    "pgrssnn_jax/effects/base.py": "reference/effects.md",
}
LINK = re.compile(r"(\]\()([^)\s#:]+)(#[^)\s]*)?(\))")
FENCE = re.compile(r"^(```.*?^```)", flags=re.M | re.S)


def on_config(config: MkDocsConfig) -> None:
    """The notebooks that are there take their place in the navigation."""
    notebooks = [{_title(path): _notebook_page(path)} for path in _notebooks()]
    entries = [
        {name: notebooks if pages == "notebooks" else pages}
        for entry in config.nav or ()
        for name, pages in entry.items()
    ]
    config.nav = [entry for entry in entries if all(entry.values())]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    texts = {**reference_pages(), "changes.md": _text("CHANGELOG.md"), "run_folder.md": _text("runs/README.md")}
    for name, text in texts.items():
        files.append(File.generated(config, name, content=text))
    for path in _notebooks():
        for name, content in _converted(path).items():
            files.append(File.generated(config, name, content=content))
    for name in sorted(set(_shown_sources(files))):
        files.append(File.generated(config, _source_page(name), content=_listing(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """README.md gives the home page its first part; links lead to the pages of the site."""
    source = page.file.src_uri
    if source == "index.md":
        markdown = markdown.replace("<!-- README -->", _opening()).replace("<!-- NOTEBOOKS -->", _notebook_list())
    return _relinked(markdown, source)


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _opening() -> str:
    """The README up to its first section, with links as from docs/."""
    text = _text("README.md").split("\n## ")[0].split("\n", 1)[1]
    return LINK.sub(lambda m: f"{m[1]}{posixpath.relpath(m[2], 'docs')}{m[3] or ''}{m[4]}", text)


def _notebook_list() -> str:
    entries = [f"- [{_title(path)}](../{path.relative_to(ROOT).as_posix()})" for path in _notebooks()]
    return "\n".join(("## Notebooks\n", *entries)) if entries else ""


def _home(source: str) -> str:
    """Where a page of the site stands in the repository."""
    for repository, site in PAGES.items():
        if source == site and repository in ("runs/README.md", "CHANGELOG.md"):
            return repository
    return source if source.startswith(("examples/", "source/")) else f"docs/{source}"


def _relinked(markdown: str, source: str) -> str:
    def link(match: re.Match[str]) -> str:
        target = _site_page(posixpath.normpath(posixpath.join(posixpath.dirname(_home(source)), match[2])))
        return f"{match[1]}{posixpath.relpath(target, posixpath.dirname(source) or '.')}{match[3] or ''}{match[4]}"

    parts = FENCE.split(markdown)
    return "".join(part if part.startswith("```") else LINK.sub(link, part) for part in parts)


def _site_page(path: str) -> str:
    """The page of the site that shows a file of the repository."""
    if path in PAGES:
        return PAGES[path]
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    if path.endswith(".ipynb"):
        return _notebook_page(Path(path))
    return _source_page(path) if (ROOT / path).exists() else path


def _source_page(path: str) -> str:
    return f"source/{path.replace('/', '.')}.md"


def _shown_sources(files: Files) -> Iterator[str]:
    """Sources that a page links to."""
    for file in files.documentation_pages():
        home = posixpath.dirname(_home(file.src_uri))
        text = file.content_string + (_opening() if file.src_uri == "index.md" else "")
        for match in LINK.finditer(FENCE.sub("", text)):
            path = posixpath.normpath(posixpath.join(home, match[2]))
            if _site_page(path).startswith("source/"):
                yield path


def _listing(path: Path) -> str:
    name = path.relative_to(ROOT)
    if path.is_dir():
        inside = sorted(file.relative_to(path).as_posix() for file in path.rglob("*.py"))
        return f"# {name}\n\n" + "\n".join(f"- `{file}`" for file in inside)
    language = {".py": "python", ".yaml": "yaml", ".cff": "yaml", ".toml": "toml"}.get(path.suffix, "text")
    return f"# {name}\n\n````{language}\n{path.read_text(encoding='utf-8')}````\n"


def _notebooks() -> list[Path]:
    return sorted((ROOT / "examples").glob("*.ipynb"))


def _notebook_page(path: Path) -> str:
    return f"examples/{path.stem}.md"


def _title(path: Path) -> str:
    """The first heading of a notebook."""
    found = re.search(r"^# (.*)$", MarkdownExporter().from_filename(path)[0], flags=re.M)
    return found[1] if found else path.stem


def _converted(path: Path) -> dict[str, Any]:
    """A stored notebook as a page, with its pictures beside it; nothing is executed."""
    notebook = nbformat.read(path, as_version=4)
    text, resources = MarkdownExporter().from_notebook_node(notebook)
    pictures = {f"{path.stem}_{name}": data for name, data in resources["outputs"].items()}
    for name in resources["outputs"]:
        text = text.replace(f"]({name})", f"]({path.stem}_{name})")
    text = text.replace(' border="1" class="dataframe"', "")  # tables look like those of the pages
    return {_notebook_page(path): text, **{f"examples/{name}": data for name, data in pictures.items()}}
