"""Materials from files and in jobs: what a run and a check say of them."""

import json

import pytest

import turnwright as tw
from turnwright.cli import main
from turnwright.errors import InputError, JobError
from turnwright.job import Job

JOB = """
[part]
radius = "1 mm"
stock = "{stock}"
material = "{material}"
[part.surface]
family = "sphere"
radius = "20 mm"
[tool]
nose_radius = "0.5 mm"
included = "100 deg"
clearance = "10 deg"
[machine]
name = "generic"
[strategy]
kind = "slow tool servo"
feed = "{feed}"
points_per_rev = 90
lead_in = "0.2 mm"
[simulation]
whole_part = {{ radii = 20, angles = 12 }}
"""


def job(tmp_path, *, stock="10 um", material="IRG 26", feed="10 um/rev"):
    file = tmp_path / "job.toml"
    file.write_text(JOB.format(stock=stock, material=material, feed=feed), encoding="utf-8")
    return file


@pytest.mark.parametrize("name", tw.Material.known())
def test_every_number_of_a_material_has_its_source(name):
    material = tw.Material.load(name)
    assert material.name
    for part, label in ((material.cutting, "cutting"), (material.thrust, "thrust"), (material.critical, "critical")):
        if part is None:
            continue
        assert f"{label}.value" in material.sources
        if part.uncertainty is not None:
            assert f"{label}.uncertainty" in material.sources
        if part.lobes is not None:
            assert {f"{label}.lobes.{key}" for key in ("count", "amplitude", "maximum")} <= set(material.sources)
    if material.fracture_ratio is not None:
        assert "fracture_ratio" in material.sources
    assert all(material.sources.values())


def test_a_brittle_finish_is_warned_of_with_the_feed_that_holds(tmp_path):
    out = tmp_path / "out"
    assert main(["run", str(job(tmp_path)), "--out", str(out)]) == 0
    told = json.loads((out / "result.json").read_text())
    chips = told["passes"][0]["chips"]
    assert not chips["ok"]
    assert chips["thickest"] * 1e6 > 600
    assert any("brittle" in one and "feed at most" in one for one in told["warnings"])
    page = (out / "report.html").read_text()
    assert "<h2>Chips</h2>" in page
    assert "thickest chip" in page.lower()
    # The feed that is named holds.
    feed = f"{chips['largest_feed'] * 1e3:.4f} um/rev"
    again = tw.run(Job.load(job(tmp_path, feed=feed)))
    assert again.passes[0].chips.thickest * 1e6 == pytest.approx(600, rel=0.02)


def test_check_names_feed_and_what_the_material_does_not_say(tmp_path, capsys):
    assert main(["check", str(job(tmp_path))]) == 0
    said = capsys.readouterr().out
    assert "finish: brittle: the chip will be about" in said
    assert "feed at most" in said
    assert main(["check", str(job(tmp_path, feed="1 um/rev"))]) == 0
    assert "ductile up to a feed of" in capsys.readouterr().out


def test_other_words_for_a_material_stay_a_note(tmp_path):
    result = tw.run(Job.load(job(tmp_path, material="what was on the shelf")))
    assert result.passes[0].chips is None
    assert not result.chips
    assert "chips" not in result.timings


def test_a_known_material_without_a_limit_is_not_judged(tmp_path):
    result = tw.run(Job.load(job(tmp_path, material="Copper, OFHC")))
    assert result.passes[0].chips is None


def test_a_material_of_ones_own_is_read_beside_the_job(tmp_path):
    (tmp_path / "mine.toml").write_text('name = "mine"\n[critical]\nvalue = "50 nm"\n', encoding="utf-8")
    read = Job.load(job(tmp_path, material="mine.toml"))
    assert read.part.substance.critical.value == pytest.approx(5e-5)
    again = Job.read({**read.model_dump(mode="json", exclude_unset=True)})
    assert again.part.substance.name == "mine"
    with pytest.raises(JobError, match="does not exist beside the job file"):
        Job.load(job(tmp_path, material="yours.toml"))


def test_a_part_without_stock_says_why_no_chip_is_found(tmp_path):
    result = tw.run(Job.load(job(tmp_path, stock="0 mm")))
    assert any("states no stock" in one for one in result.warnings)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('name = ""', "no name"),
        ('name = "a"\nkc = 3', "'kc' in the file is not known"),
        ('name = "a"\n[cutting]\nn_per_mm2 = "1489"', "give a plain number"),
        ('name = "a"\n[cutting]\nn_per_mm2 = 1489', "one cutting coefficient of two"),
        ('name = "a"\n[cutting]\nn_per_mm2 = -3\n[thrust]\nn_per_mm2 = 3', "must be finite and above 0"),
        ('name = "a"\n[critical]\nvalue = 600', "critical.value"),
        ('name = "a"\n[critical]\nvalue = "600 nm"\nrake = { at_deg = [0, -25], factor = [1, 2] }', "ascending"),
        ('name = "a"\n[critical]\nvalue = "600 nm"\nlobes = { count = 3 }', "lobes.amplitude is missing"),
        ('name = "a"\nbrittle_plateau = true', "no critical thickness"),
        ('name = "a"\n[cutting]\nn_per_mm2 = 3\nexponent = 0.3\n[thrust]\nn_per_mm2 = 3', "no reference_thickness"),
        ("name = 3", "must be a text"),
        ('name = "a"\n[sources]\ncritical = 3', "must be a text"),
        ("name = [", "is not TOML"),
    ],
)
def test_a_wrong_material_file_is_one_sentence(tmp_path, text, words):
    file = tmp_path / "wrong.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as error:
        tw.Material.load(file)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="is not one of"):
        tw.Material.load(tmp_path / "none.toml")
