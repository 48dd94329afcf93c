"""The site builds without a warning, loads nothing from a network, and shows every public name and every setting."""

import os
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from commands import ROOT

import pgrssnn_jax as pg
from pgrssnn_jax import effects, physics
from pgrssnn_jax.discovery.settings import Criteria, DiscoverySettings
from pgrssnn_jax.training.settings import GROUPS

pytest.importorskip("mkdocs", reason="the extra `docs` is not installed")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    unreachable = {"http_proxy": "http://127.0.0.1:9", "https_proxy": "http://127.0.0.1:9", "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, env={**os.environ, **unreachable}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


def page(site: Path, name: str) -> str:
    return (site / name).read_text(encoding="utf-8")


def test_every_page_is_there_and_is_in_the_navigation(site):
    home = page(site, "index.html")
    for path in (ROOT / "docs").glob("*.md"):
        assert (site / f"{path.stem}.html").exists()
        assert f'href="{path.stem}.html"' in home or path.stem == "index"
    for path in (ROOT / "examples").glob("*.ipynb"):
        assert f'href="examples/{path.stem}.html"' in home


def test_no_page_loads_anything_from_a_network(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 15
    for path in pages:
        loaded = re.findall(r'<(?:script|img|iframe|source)[^>]*\bsrc="([^"]+)"', path.read_text(encoding="utf-8"))
        loaded += re.findall(r'<link[^>]*rel="(?:stylesheet|icon|preconnect)"[^>]*href="([^"]+)"', path.read_text())
        assert loaded
        assert not [link for link in loaded if re.match(r"(\w+:)?//", link)], path.name


def test_the_reference_shows_every_public_name(site):
    public = set(pg.__all__) - {"physics", "effects"}
    for file, short, names in (
        ("api", "pg", public), ("physics", "pg.physics", physics.__all__), ("effects", "pg.effects", effects.__all__),
    ):  # fmt: skip
        text = page(site, f"reference/{file}.html")
        for name in names:
            assert re.search(rf"<h2[^>]*>.*?{short}\.{name}\b", text, flags=re.S), name


def test_the_settings_stand_with_their_defaults(site):
    text = page(site, "reference/settings.html")
    rows = dict(re.findall(r"<td><code>([\w.]+)</code></td>\s*<td><code>(.*?)</code></td>", text))
    prefixes = {"run": ""}
    for group, kind in {**GROUPS, "discovery": DiscoverySettings}.items():
        for field in fields(kind):
            name = f"{prefixes.get(group, f'{group}.')}{field.name}"
            shown = rows[name].replace("&#39;", "'").replace("&quot;", '"')
            assert shown == repr(getattr(kind(), field.name)), name
    assert set(Criteria._fields) <= set(rows)


def test_explained_arguments_are_a_list(site):
    assert re.search(r"<li><code>recipe</code>: ", page(site, "reference/api.html"))
