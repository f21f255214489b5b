"""The parts of the documentation site: order of pages, links, pages of the API, and the pages made of files."""

from pathlib import Path

import pytest

import jaxplan
from tools.site import source
from tools.site.api import GROUPS, MODULES, api_pages, modules_named_in
from tools.site.links import faults
from tools.site.nav import NAV, as_toml, navigation


def test_every_public_name_is_in_one_group_and_has_a_page() -> None:
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted(grouped) == jaxplan.__all__
    pages = dict(api_pages([]))
    for name in jaxplan.__all__:
        assert f"::: {jaxplan._HOME_OF[name]}.{name}\n" in pages[f"api/{name}.md"]
        assert f"[`{name}`]({name}.md)" in pages["api/index.md"]
    assert {f"api/{module}.md" for module in MODULES} <= set(pages)


def test_modules_that_pages_name_are_found() -> None:
    text = "``jaxplan.io.export.read_trajectory`` and `jaxplan.runtime`, not jaxplan.nowhere, cli is jaxplan.cli.main"
    assert modules_named_in([text, "jaxplan.World, out/jaxplan.io.plans"]) == {"jaxplan.io.export", "jaxplan.runtime"}


def test_all_modules_that_the_docs_name_have_a_page(repository: Path) -> None:
    docs = [page.read_text(encoding="utf-8") for page in source.guides()]
    named = modules_named_in(docs)
    assert {"jaxplan.runner.definition", "jaxplan.tracking.disturbance", "jaxplan.policy.checkpoint"} <= named
    assert {f"api/{module}.md" for module in named} <= set(dict(api_pages(docs)))
    assert repository / "docs" / "howto" / "policy.md" in source.guides()


def test_navigation_takes_what_is_there_and_forgets_nothing() -> None:
    pages = ["index.md", "view.md", "decisions/0001-a.md", "new.md", "files/x.md", "results/a/report.md"]
    nav = navigation(pages)
    assert {"More": ["new.md"]} in nav
    assert {"Experiments": [{"a": "results/a/report.md"}]} in nav
    text = str(nav)
    assert all(page in text for page in pages if page != "files/x.md")
    assert "files/x.md" not in text
    assert "mavlink.md" not in text
    assert {"More": ["new.md"]} not in navigation(pages[:1])


def test_navigation_names_no_page_twice() -> None:
    found = str(navigation(["howto/map.md", "examples/index.md", "examples/01_a.md", "api/index.md", "api/World.md"]))
    assert all(found.count(f"'{page}'") == 1 for page in ("howto/map.md", "examples/01_a.md", "api/World.md"))


def test_navigation_in_toml_is_what_it_was() -> None:
    import tomllib

    assert tomllib.loads(f"nav = {as_toml(NAV)}")["nav"] == NAV


def written(folder: Path, **pages: str) -> Path:
    for name, text in pages.items():
        (folder / f"{name}.html").write_text(text)
    return folder


def test_a_sound_site_has_no_faults(tmp_path: Path) -> None:
    (tmp_path / "a b.png").write_bytes(b"")
    one = (
        '<a href="two.html#there">x</a><img src="a%20b.png"><a href="https://example.org">y</a><a href="#top" id="top">'
    )
    assert faults(written(tmp_path, one=one, two='<h1 id="there">z</h1><a href="mailto:a@b.c">m</a>')) == []


@pytest.mark.parametrize(
    ("html", "fault"),
    [
        ('<a href="gone.html">', "dead link gone.html"),
        ('<img src="gone.png">', "dead link gone.png"),
        ('<a href="one.html#gone">', "no anchor one.html#gone"),
        ('<a href="#gone">', "no anchor #gone"),
        ('<script src="https://example.org/a.js">', "fetches https://example.org/a.js"),
        ('<link rel="stylesheet" href="//example.org/a.css">', "fetches //example.org/a.css"),
        ('<a href="folder/">', "dead link folder/"),
    ],
)
def test_a_fault_is_told(tmp_path: Path, html: str, fault: str) -> None:
    (tmp_path / "folder").mkdir()
    assert faults(written(tmp_path, one=html)) == [f"one.html: {fault}"]


def test_links_out_of_the_docs_become_pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text in {
        "docs/a.md": "[code](../b/c.py) [log](../CHANGELOG.md) [ex](../examples/01_x.py) [deep](d/e.md#f)\n",
        "docs/d/e.md": "[up](../a.md) [json](../../b/c.py)\n```\n[no link](nowhere.md)\n```\n",
        "b/c.py": "x = 1\n",
        "examples/01_x.py": '"""X."""\n',
        "CHANGELOG.md": "[a](docs/a.md)\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(source, "ROOT", tmp_path)
    monkeypatch.setattr(source, "DOCS", tmp_path / "docs")
    outside: set[str] = set()
    text = source._with_links(tmp_path / "docs" / "a.md", "a.md", outside)
    assert text == "[code](files/b/c.py.md) [log](changelog.md) [ex](examples/01_x.md) [deep](d/e.md#f)\n"
    deep = source._with_links(tmp_path / "docs" / "d" / "e.md", "d/e.md", outside)
    assert deep == "[up](../a.md) [json](../files/b/c.py.md)\n```\n[no link](nowhere.md)\n```\n"
    assert source._with_links(tmp_path / "CHANGELOG.md", "changelog.md", outside) == "[a](a.md)\n"
    assert outside == {"b/c.py"}
    assert "````python\nx = 1\n````" in source._shown("b/c.py")
    (tmp_path / "docs" / "a.md").write_text("[gone](gone.md)")
    with pytest.raises(LookupError, match=r"docs/a\.md leads to gone\.md"):
        source._with_links(tmp_path / "docs" / "a.md", "a.md", outside)
