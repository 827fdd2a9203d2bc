"""What the documentation promises: complete lists, short records, and a README whose example runs."""

import operator
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import turnwright

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
RECORDS = sorted((DOCS / "decisions").glob("[0-9]*.md"))
DEPENDENCIES = (DOCS / "decisions" / "0002-dependencies.md").read_text(encoding="utf-8")


def test_the_nomenclature_lists_every_public_name():
    listed = re.findall(
        r"^\| `([\w.]+)` \| [^|]+ \|$", (DOCS / "nomenclature.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert [name for name in listed if "." not in name] == sorted(turnwright.__all__)
    assert sorted(listed) == sorted(documented())


def documented():
    """Return every name that the reference documents, as it follows ``turnwright.``."""
    text = (DOCS / "reference.md").read_text(encoding="utf-8")
    return re.findall(r"^\.\. auto(?:class|function|exception):: turnwright\.([\w.]+)$", text, re.MULTILINE)


def test_every_family_of_surfaces_is_documented():
    families = [
        name
        for name in turnwright.surface.__all__
        if name[0].isupper() and hasattr(getattr(turnwright.surface, name), "sag")
    ]
    assert len(families) > 15
    assert set(families) <= {name.rpartition(".")[2] for name in documented()}


def test_the_reference_documents_every_public_name_once():
    listed = documented()
    assert len(set(listed)) == len(listed)
    assert set(turnwright.__all__) <= set(listed)
    for name in listed:
        assert operator.attrgetter(name)(turnwright)


def test_every_citation_is_in_the_bibliography():
    cited = set()
    for source in (ROOT / "src").rglob("*.py"):
        cited |= set(re.findall(r"\[(\w+)\]_", source.read_text(encoding="utf-8")))
    known = set(re.findall(r"^\.\. \[(\w+)\]", (DOCS / "sources.md").read_text(encoding="utf-8"), re.MULTILINE))
    assert cited <= known


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.stem)
def test_a_decision_is_short_and_complete(record):
    text = record.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 40
    assert re.findall(r"^\*\*(.+?)\.\*\*", text, re.MULTILINE) == [
        "Context",
        "Choice",
        "Price",
        "What would change our mind",
    ]


def required():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    return sorted({re.match(r"[A-Za-z0-9-]+", line)[0] for group in groups for line in group} - {"turnwright"})


@pytest.mark.parametrize("name", required())
def test_every_dependency_is_justified(name):
    assert f"**{name}**" in DEPENDENCIES


def test_no_dependency_is_justified_that_is_not_there():
    assert set(re.findall(r"\*\*([a-z0-9-]+)\*\*", DEPENDENCIES)) <= set(required())


def test_the_example_of_the_readme_runs_and_prints_what_it_says(tmp_path, monkeypatch, capsys):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks[0], "README.md", "exec"), {})  # noqa: S102 - our own text
    printed = capsys.readouterr().out.strip()
    assert f"`{printed}`" in text


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "CHANGELOG.md"], ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


def test_pictures_stay_small():
    assert all(picture.stat().st_size < 300_000 for picture in (DOCS / "images").glob("*.png"))


def test_the_modules_of_public_names_need_no_import_of_their_own():
    code = (
        "import sys, turnwright as tw; assert 'turnwright.metrology' not in sys.modules; "
        "assert tw.metrology.turning_centre and tw.files.read_map is tw.read_map; tw.nonsense"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "No turnwright attribute nonsense" in run.stderr.splitlines()[-1]
