"""A job to start from, for every family and strategy. Oracle: it reads, also with every optional line stated."""

import re
import tomllib

import pytest

from turnwright.cli import main
from turnwright.job import Job, job_schema, job_template, preview, reference_tables
from turnwright.strategy import STRATEGIES
from turnwright.surface import FAMILIES

HEIGHTS = "x,y,z\n" + "".join(f"{x},{y},0.0\n" for x in range(-6, 7) for y in range(-6, 7))


@pytest.mark.parametrize("family", FAMILIES)
def test_a_template_of_a_family_is_a_job_that_can_be_cut(tmp_path, monkeypatch, family):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "heights.csv").write_text(HEIGHTS)
    assert main(["new", family, "--out", "job.toml"]) == 0
    job = Job.load(tmp_path / "job.toml")
    assert preview(job).refused == ()


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_template_of_a_strategy_is_a_job(strategy):
    job = Job.read(tomllib.loads(job_template("lens array", strategy)))
    assert job.strategy.kind == strategy


@pytest.mark.parametrize("family", FAMILIES)
def test_every_optional_line_of_a_template_is_one_of_toml(family):
    text = job_template(family)
    assert max(map(len, text.splitlines())) <= 120
    assert tomllib.loads(re.sub(r"(?m)^#(?=[a-z_]+ = )", "", text)).keys() >= {"part", "tool", "machine", "strategy"}


def test_what_is_not_known_is_one_sentence(tmp_path, capsys):
    assert main(["new", "spere", "--out", str(tmp_path / "job.toml")]) == 2
    assert "'spere' is not known: did you mean 'sphere'?" in capsys.readouterr().err
    assert not (tmp_path / "job.toml").exists()


def test_the_reference_has_every_key_with_an_explanation():
    """Oracle: the JSON schema by which a job is read."""
    found = {table.title: {key.name for key in table.keys} for table in reference_tables()}
    wanted = {name: set(one["properties"]) for name, one in job_schema()["$defs"].items() if "properties" in one}
    assert found == wanted
    bare = [f"{table.place}.{key.name}" for table in reference_tables() for key in table.keys if not key.text]
    assert bare == []
