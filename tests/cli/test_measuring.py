"""The commands of a measured part. Oracles: the errors that were injected, plain readers of what is written."""

import difflib
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import turnwright as tw
from dish import DISH, OFFSET, seen
from job_files import written
from turnwright._signals import Stop
from turnwright.cli import main
from turnwright.diagnosis import report as _draws
from turnwright.job import Job, correction as _correct, measurement as _measure

DIAGNOSE = _measure._diagnose_all


def once(stage, key):
    """Return a stage of the program that takes what has an equal key from the first time."""
    known = []

    def found(*given):
        wanted = key(*given)
        for other, answer in known:
            if other == wanted:
                return answer
        known.append((wanted, stage(*given)))
        return known[-1][1]

    return found


@pytest.fixture(scope="module", autouse=True)
def computed_once():
    """The same maps of the same jobs have one diagnosis and one proof: most of these tests only go on from them.

    A proof cuts an eighth of its next parts: how much of them it takes is not the subject here.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_draws, "DRAWS", 25)
        patch.setattr(
            _measure, "_diagnose_all", once(DIAGNOSE, lambda every: [(one.job, one.fingerprint) for one in every])
        )
        patch.setattr(
            _correct, "_choose_plan", once(_correct._choose_plan, lambda job, found, own: (job, id(found), own))
        )
        patch.setattr(_correct, "_check_linear", once(_correct._check_linear, lambda job, draws, _: (job, id(draws))))
        yield


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    """A job, and the map of the part that it cut."""
    folder = tmp_path_factory.mktemp("shop")
    written(folder, *DISH)
    seen(folder / "job.toml", folder / "dish.x3p")
    return folder


@pytest.fixture(scope="module")
def corrected(shop):
    out = shop / "corrected"
    assert main(["correct", str(shop / "dish.x3p"), "--job", str(shop / "job.toml"), "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def second(shop, corrected):
    """The map of a part that the corrected job has cut."""
    return seen(corrected / "job.toml", shop / "second.npz")


def files_of(folder):
    return {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}


def strict(file):
    def refuse(constant):
        raise AssertionError(constant)

    return json.loads(file.read_text(encoding="utf-8"), parse_constant=refuse)


def test_measure_names_the_instrument_and_what_it_removes(shop, tmp_path, capsys):
    out = tmp_path / "seen"
    stated = ["--set", 'instrument={resolution="10 um"}']
    assert main(["measure", str(shop / "dish.x3p"), "--job", str(shop / "job.toml"), "--out", str(out), *stated]) == 0
    assert "optics pass periods above 10 um" in capsys.readouterr().out
    texture = strict(out / "measured.json")["texture"]
    # Of a feed of twice the resolution incoherent light passes 2 / pi (pi / 3 - sqrt(3) / 4).
    assert texture["seen_nm"] / texture["predicted_nm"] == pytest.approx(0.391, rel=0.1)
    assert "Effect of the instrument" in (out / "report.html").read_text(encoding="utf-8")
    wrong = ["--out", str(tmp_path / "no"), "--set", "instrument=zygo"]
    assert main(["measure", str(shop / "dish.x3p"), "--job", str(shop / "job.toml"), *wrong]) == 2
    assert "zygo-nexview-10x" in capsys.readouterr().err


def test_measure_says_how_far_the_part_is_off(shop, tmp_path, capsys):
    """Oracle: an offset of the tip leaves a cone, offset times slope, whose rms less piston is known in closed form."""
    out = tmp_path / "measured"
    assert main(["measure", str(shop / "dish.x3p"), "--job", str(shop / "job.toml"), "--out", str(out)]) == 0
    assert "form error PV" in capsys.readouterr().out
    assert files_of(out) == {"report.html", "measured.json", "error.npz"}
    report = strict(out / "measured.json")
    error = tw.read_map(out / "error.npz")
    radius, z = np.hypot(*error.points()), error.z
    known = ~np.isnan(z)
    rows = np.stack([np.ones(known.sum()), radius[known] ** 2], axis=1)
    cone = OFFSET * radius[known] / 20
    assert report["form_rms_nm"] == pytest.approx(1e6 * np.std(z[known]), rel=0.05)
    left, expected = (np.std(one - rows @ np.linalg.lstsq(rows, one, rcond=None)[0]) for one in (z[known], cone))
    cusps = 0.02**2 / (8 * 0.5) * np.sqrt(4 / 45)
    assert left == pytest.approx(np.sqrt(expected**2 + cusps**2 + 5e-6**2), rel=0.1)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Form in fringe Zernike terms" in page
    assert "<script src" not in page
    # What no tolerance judges is neither good nor bad.
    assert '<section class="verdict plain"' in page
    assert "tolerances.form_pv" in page


@pytest.mark.parametrize(("allowed", "grade", "code"), [("10 um", "good", 0), ("1 nm", "bad", 4)])
def test_a_stated_tolerance_judges_the_form(shop, tmp_path, allowed, grade, code):
    judged = written(tmp_path, *DISH, ("tolerances.form_pv", allowed))
    out = tmp_path / "measured"
    assert main(["measure", str(shop / "dish.x3p"), "--job", str(judged), "--out", str(out)]) == code
    assert f'<section class="verdict {grade}"' in (out / "report.html").read_text(encoding="utf-8")


def test_diagnose_finds_what_was_injected(shop, tmp_path, capsys):
    out = tmp_path / "why"
    assert main(["diagnose", str(shop / "dish.x3p"), "--job", str(shop / "job.toml"), "--out", str(out)]) == 0
    assert "\ncorrect: offset x is +" in capsys.readouterr().out
    assert files_of(out) == {"report.html", "diagnosis.json", "left-1.npz"}
    found = {one["name"]: one for one in strict(out / "diagnosis.json")["findings"]}
    low, high = found["offset x"]["interval"]
    assert 0 < low < OFFSET < high
    assert {one["name"] for one in strict(out / "diagnosis.json")["contributions"]} >= {"drift of Z", "low form"}
    assert tw.read_map(out / "left-1.npz").z.size > 1000
    page = (out / "report.html").read_text(encoding="utf-8")
    (move,) = re.findall(r">X</th><td[^>]*>([^<]*)</td>", page)
    # Back to where it belongs, as near as a drift that looks alike lets. [um]
    assert float(move.replace("\u2212", "-")) == pytest.approx(-OFFSET * 1e3, abs=0.5)
    assert "8 R/A PV" in page  # the dish is a sphere


def test_correct_writes_a_job_that_runs(shop, corrected, second, tmp_path):
    """Oracle: what the corrected job leaves, cut by the tool as it is, judged by the design."""
    assert {"report.html", "correction.json", "job.toml", "predicted.npz"} <= files_of(corrected)
    better = Job.load(corrected / "job.toml")
    assert better.tool.offset[0] == pytest.approx(OFFSET, abs=5e-4)
    assert better.part.surface == Job.load(shop / "job.toml").part.surface
    out = tmp_path / "run"
    assert main(["run", str(corrected / "job.toml"), "--out", str(out)]) == 0
    whole = strict(out / "result.json")["predictions"][0]
    cusps = 0.02**2 / (8 * 0.5) * 1e6
    assert whole["roughness"]["sq_nm"] < cusps
    assert main(["measure", str(second), "--job", str(corrected / "job.toml"), "--out", str(tmp_path / "second")]) == 0
    before = strict(corrected / "correction.json")["measured"][0]["form_rms_nm"]
    after = strict(tmp_path / "second" / "measured.json")["form_rms_nm"]
    assert after < 40  # cusps, noise
    assert before > 2 * after


def test_a_corrected_part_is_not_corrected_again(shop, corrected, second, tmp_path, capsys):
    """The residual of the second part is cusps and noise: no job is written, whatever other map is given."""
    jobs = ["--job", str(corrected / "job.toml"), "--job", str(shop / "job.toml")]
    there = sorted(tmp_path.iterdir())
    for maps, its in (([str(second)], jobs[:2]), ([str(second), str(shop / "dish.x3p")], jobs)):
        assert main(["correct", *maps, *its, "--out", str(tmp_path / "out")]) == 3
        assert "no correction is written" in told_once(capsys)
        assert sorted(tmp_path.iterdir()) == there
    out = tmp_path / "why"
    assert main(["diagnose", str(second), str(shop / "dish.x3p"), *jobs, "--out", str(out)]) == 0
    report = strict(out / "diagnosis.json")
    assert len(report["measured"]) == 2
    assert report["repeatability_nm"] < 5


def test_a_map_is_not_corrected_twice(shop, corrected, tmp_path, capsys):
    """The map of the first part, given with the job that was corrected by it, would be corrected again."""
    first, job = str(shop / "dish.x3p"), str(corrected / "job.toml")
    assert main(["correct", first, "--job", job, "--out", str(tmp_path / "out")]) == 2
    assert "earlier correction of this job" in told_once(capsys)
    assert list(tmp_path.iterdir()) == []
    again = tw.read_map(first)
    tw.write_map(replace(again, z=again.z + 3e-3), tmp_path / "lifted.npz")  # the same measurement, in another file
    assert main(["correct", str(tmp_path / "lifted.npz"), "--job", job, "--out", str(tmp_path / "out")]) == 2
    assert "earlier correction of this job" in told_once(capsys)
    noise = 5e-6 * np.random.default_rng(6).normal(size=again.z.shape)
    tw.write_map(replace(again, z=again.z + noise), tmp_path / "new.npz")  # the old part, measured again
    assert main(["correct", str(tmp_path / "new.npz"), "--job", job, "--out", str(tmp_path / "out")]) == 2
    assert "cut before the correction" in told_once(capsys)
    old = [first, str(tmp_path / "lifted.npz"), "--job", str(shop / "job.toml"), "--out", str(tmp_path / "out")]
    assert main(["correct", *old]) == 2
    assert "given twice" in told_once(capsys)
    assert not (tmp_path / "out").exists()


def test_a_tool_that_moved_again_is_corrected_again(shop, corrected, tmp_path):
    """Oracle: where the tool is. By 73 % of what was corrected the new part is off in the same way."""
    seen(corrected / "job.toml", tmp_path / "moved.npz", offset=OFFSET + 0.0022)
    out = tmp_path / "out"
    job = str(corrected / "job.toml")
    assert main(["correct", str(tmp_path / "moved.npz"), "--job", job, "--out", str(out)]) == 0
    assert Job.load(out / "job.toml").tool.offset[0] == pytest.approx(OFFSET + 0.0022, abs=5e-4)


def test_a_part_may_be_stated_as_cut_by_the_corrected_job(shop, corrected, tmp_path, capsys):
    """The same error came back: nothing in the map tells that from a part that was cut before."""
    seen(corrected / "job.toml", tmp_path / "again.npz", offset=2 * OFFSET)
    out, job = tmp_path / "out", tmp_path / "jobs" / "job.toml"
    text = (shutil.copytree(corrected, job.parent) / "job.toml").read_text(encoding="utf-8")
    job.write_text(text.replace("[measurement]", '[measurement]\ncut_by = "this job"'), encoding="utf-8")
    common = ["correct", str(tmp_path / "again.npz"), "--out", str(out), "--job"]
    assert main([*common, str(corrected / "job.toml")]) == 2
    assert 'cut_by = "this job"' in told_once(capsys)
    assert main([*common, str(job)]) == 0
    assert "cut_by" not in (out / "job.toml").read_text(encoding="utf-8")  # of the next part nothing is known
    assert Job.load(out / "job.toml").tool.offset[0] == pytest.approx(2 * OFFSET, abs=7e-4)
    assert main([*common, str(corrected / "job.toml"), "--force", "--set", "cut_by=this job"]) == 0


def test_test_parts_correct_the_job_of_the_part(shop, tmp_path, capsys):
    maps, jobs = [], []
    for kind in ("tilted flat", "concave sphere"):
        job = tmp_path / f"{kind.replace(' ', '-')}.toml"
        assert main(["test-part", str(shop / "job.toml"), "--kind", kind, "--out", str(job)]) == 0
        maps.append(str(seen(job, tmp_path / f"{job.stem}.npz")))
        jobs += ["--job", str(job)]
    out = tmp_path / "out"
    assert main(["correct", *maps, *jobs, "--of", str(shop / "job.toml"), "--out", str(out)]) == 0
    better = Job.load(out / "job.toml")
    assert better.part.surface == Job.load(shop / "job.toml").part.surface
    assert better.tool.offset[0] == pytest.approx(OFFSET, abs=5e-4)
    assert better.part.correction is None
    capsys.readouterr()
    assert main(["test-part", str(shop / "job.toml"), "--kind", "cube", "--out", str(tmp_path / "cube.toml")]) == 2
    assert '"tilted flat" or "concave sphere"' in capsys.readouterr().err
    assert not (tmp_path / "cube.toml").exists()


BY_HAND = """\
# Dish 12, drawing 4711
[tool]   # certificate 88
nose_radius = "500 um"
included = "60 deg" # of the shop's drawer
clearance = "0.15 rad"

[machine]
name = "generic"
plausible = { squareness = "5 urad" } # certificate of the slide

[part]
name = "dish"
radius = "0.2 cm"
surface = { family = "sphere", radius = "2 cm" } # concave

[strategy]
# as we always do it
kind = "slow tool servo"
feed = "20000 nm/rev"
points_per_rev = 120
spindle_speed = "60 rpm"

[simulation]
whole_part = { radii = 41, angles = 24 }
"""


def lines_lost(text):
    report = list(difflib.ndiff(BY_HAND.splitlines(), text.splitlines()))
    return [line[2:] for line in report if line[0] == "-"], [line[2:] for line in report if line[0] == "+"]


def test_a_correction_keeps_what_a_person_wrote(shop, tmp_path):
    """Oracle: the lines of the file, by difflib; what is known of the tool is new, all else stays."""
    job = tmp_path / "job.toml"
    job.write_text(BY_HAND, encoding="utf-8")
    out = tmp_path / "better"
    assert main(["correct", str(shop / "dish.x3p"), "--job", str(job), "--out", str(out)]) == 0
    lost, new = lines_lost((out / "job.toml").read_text(encoding="utf-8"))
    assert lost == []
    assert any(line.startswith("offset = ") for line in new)
    moved = out.rename(tmp_path / "moved")  # files next to the job are named so that the folder can move
    assert Job.load(moved / "job.toml").tool.offset[0] == pytest.approx(OFFSET, abs=5e-4)
    again = tmp_path / "again"
    command = ["correct", str(shop / "dish.x3p"), "--job", str(job), "--of", str(job), "--out", str(again)]
    assert main(command) == 0
    assert lines_lost((again / "job.toml").read_text(encoding="utf-8"))[0] == []


def test_a_test_part_keeps_what_a_person_wrote(tmp_path):
    """Oracle: the lines of the file, by difflib; the part is another, all else stays."""
    job, out = tmp_path / "job.toml", tmp_path / "flat.toml"
    job.write_text(BY_HAND, encoding="utf-8")
    assert main(["test-part", str(job), "--kind", "tilted flat", "--out", str(out)]) == 0
    lost, _ = lines_lost(out.read_text(encoding="utf-8"))
    assert {line.partition(" = ")[0] for line in lost} <= {"name", "surface", "whole_part", "[simulation]", ""}
    assert 'radius = "0.2 cm"' in out.read_text(encoding="utf-8")
    assert Job.load(out).part.surface.family == "plane"
    assert Job.load(out).tool == Job.load(job).tool


def told_once(capsys):
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("turnwright: ")]
    assert len(lines) == 1
    return lines[0]


def test_bad_input_is_one_sentence_and_leaves_nothing(shop, tmp_path, capsys):
    good, job = str(shop / "dish.x3p"), str(shop / "job.toml")
    bare = str(seen(shop / "job.toml", tmp_path / "bare.npz", calibrated=False))
    far = tmp_path / "far.npz"
    away = tw.read_map(good)
    tw.write_map(tw.HeightMap(x=away.x, y=away.y, z=np.full(away.z.shape, np.nan)), far)
    torn = tmp_path / "torn.x3p"
    torn.write_bytes(Path(good).read_bytes()[:500])
    unknown = written(tmp_path, *DISH, ("measurement", {"error_sources": ["bad luck"]})).rename(
        tmp_path / "unknown.toml"
    )
    other = written(tmp_path, *DISH, ("tool.nose_radius", "0.6 mm"), ("part.name", "other"))
    other = other.rename(tmp_path / "other.toml")
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "notes.txt").write_text("cut on Monday")
    cases = [
        (["measure", str(tmp_path / "no.x3p"), "--job", job], "no.x3p"),
        (["measure", bare, "--job", job], "pixel size"),
        (["measure", str(far), "--job", job], "0 "),
        (["measure", str(torn), "--job", job], "torn.x3p"),
        (["measure", good, "--job", str(tmp_path / "no.toml")], "no.toml"),
        (["diagnose", good, "--job", str(unknown)], "bad luck"),
        (["diagnose", good, good, "--job", job, "--job", job, "--job", job], "got 3 jobs for 2 maps"),
        (["diagnose", good, good, "--job", job, "--job", str(other)], "different tools or machines"),
        (["correct", good, "--job", job, "--of", str(other)], "nose radius 0.6 mm"),
    ]  # fmt: skip
    for arguments, words in cases:
        there = sorted(tmp_path.iterdir())
        assert main([*arguments, "--out", str(tmp_path / "out")]) == 2, arguments
        assert words in told_once(capsys)
        assert sorted(tmp_path.iterdir()) == there
    assert main(["correct", good, "--job", job, "--out", str(tmp_path / "taken")]) == 2
    assert "not empty" in told_once(capsys)
    assert [one.name for one in (tmp_path / "taken").iterdir()] == ["notes.txt"]


def test_a_damaged_correction_is_refused(shop, tmp_path, capsys):
    axis = np.linspace(-3, 3, 13)
    for name, heights in {"torn": None, "missing": np.full((13, 13), np.nan)}.items():
        file = tmp_path / f"{name}.npz"
        if heights is None:
            file.write_bytes(b"PK\x03\x04 half")
        else:
            tw.write_map(tw.HeightMap(x=axis, y=axis, z=heights), file)
        job = written(tmp_path, *DISH, ("part.correction", file.name))
        assert main(["check", str(job)]) == 2
        assert f"{name}.npz" in told_once(capsys)


def test_an_interrupt_leaves_nothing(shop, tmp_path, monkeypatch, capsys):
    checked = []

    def interrupt(_stop):
        checked.append(1)
        if len(checked) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(Stop, "check", interrupt)
    arguments = ["correct", str(shop / "dish.x3p"), "--job", str(shop / "job.toml"), "--out", str(tmp_path / "out")]
    assert main(arguments) == 130
    assert re.search("interrupt|stopped", capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == []


def test_a_correction_goes_into_any_folder(shop, tmp_path, monkeypatch):
    """Oracle: the job that was written is read again as the one that is returned."""
    monkeypatch.chdir(tmp_path)
    job = Job.load(shop / "job.toml")
    seen_map = tw.read_map(shop / "dish.x3p")
    x, y = np.meshgrid(seen_map.x, seen_map.y)
    bump = 2e-4 * np.exp(
        -((x - 0.6) ** 2 + (y - 0.4) ** 2) / 0.5
    )  # a form that no cause explains, so a table is written
    measured = tw.measure(job, replace(seen_map, z=seen_map.z + bump))
    found = tw.diagnose(measured)
    for out in (Path("better"), tmp_path / "not" / "there yet"):
        better = tw.correct(job, found, measured, out=out)
        assert better.file.samefile(out / "job.toml")
        assert better.job.part.correction is not None
        assert Job.load(out / "job.toml") == better.job


def test_measure_and_diagnose_state_the_same_form_error(shop, monkeypatch):
    """Also of a map of more points than the diagnosis takes, whose cells average the noise out."""
    monkeypatch.setattr(_measure, "CELL_COUNT", 2000)
    job = Job.load(shop / "job.toml")
    axis = np.linspace(-2, 2, 101)
    x, y = np.meshgrid(axis, axis)
    z = tw.Sphere(radius=20.0).sag(x, y) + 20e-6 * np.hypot(x, y) ** 3
    z += 8e-6 * np.random.default_rng(1).normal(size=z.shape)
    measured = tw.measure(job, tw.HeightMap(x=axis, y=axis, z=np.where(np.hypot(x, y) < 1.95, z, np.nan)))
    found = tw.diagnose(measured)
    assert found.measured_rms_nm == pytest.approx(measured.form_rms_nm, rel=1e-9)
    assert found.unexplained_rms_nm > 6
    assert measured.registration.noise_nm == pytest.approx(8, rel=0.05)


def test_a_mask_leaves_heights_out(shop, tmp_path):
    """Oracle: the heights that the mask has; the form error of a part that is spoilt where it has none."""
    axis = np.linspace(-2, 2, 101)
    x, y = np.meshgrid(axis, axis)
    z = np.where(np.hypot(x, y) < 1.95, tw.Sphere(radius=20.0).sag(x, y), np.nan)
    spoilt = np.hypot(x - 0.8, y) < 0.5
    tw.write_map(tw.HeightMap(x=axis, y=axis, z=np.where(spoilt, np.nan, 0.0)), tmp_path / "mask.npz")
    heights = tw.HeightMap(x=axis, y=axis, z=z + 1e-3 * spoilt)
    job = written(tmp_path, *DISH, ("measurement.mask", "mask.npz"))
    measured = tw.measure(Job.load(job), heights)
    assert np.isfinite(measured.heights.z).sum() == (np.isfinite(z) & ~spoilt).sum()
    assert measured.form_rms_nm < 0.1
    (tmp_path / "mask.npz").unlink()
    tw.write_map(tw.HeightMap(x=axis, y=axis, z=np.where(spoilt, 0.0, 1.0)), tmp_path / "mask.npz")
    again = tw.measure(Job.load(job), heights)
    assert np.array_equal(again.heights.z, measured.heights.z, equal_nan=True)
    small = replace(heights, x=axis[1:], y=axis, z=heights.z[:, 1:])
    with pytest.raises(tw.InputError, match=r"mask.npz has the shape \(101, 101\), the map \(101, 100\)"):
        tw.measure(Job.load(job), small)
    (tmp_path / "mask.npz").unlink()
    tw.write_map(tw.HeightMap(x=axis, y=axis, z=x), tmp_path / "mask.npz")
    with pytest.raises(tw.InputError, match=r"mask.npz has no missing heights"):
        tw.measure(Job.load(job), heights)


def test_set_replaces_a_key_of_the_measurement(shop, tmp_path, capsys):
    """Oracle: the numbers that are fitted; and the job's own refusal of a key that it does not have."""
    common = ["measure", str(shop / "dish.x3p"), "--job", str(shop / "job.toml")]
    for k, (keys, free) in enumerate([([], True), (["--set", 'free=["z"]', "--set", "form_error=0 um"], False)]):
        assert main([*common, "--out", str(tmp_path / str(k)), *keys]) in (0, 4)
        assert ("tilt_x" in strict(tmp_path / str(k) / "measured.json")["registration"]["std"]) == free
    capsys.readouterr()
    assert main([*common, "--out", str(tmp_path / "bad"), "--set", "colour=red"]) == 2
    assert "colour" in capsys.readouterr().err
    assert main([*common, "--out", str(tmp_path / "bad"), "--set", "undetermined"]) == 2
    assert "KEY=VALUE" in capsys.readouterr().err


REGISTERED = {
    "loss": ("huber", {"loss": "huber"}),
    "form_error": ("2 um", {"form_error": 2e-3}),
    "undetermined": ("hold", {"undetermined": "hold"}),
    "reach": ("1 mm", {"reach": 1.0}),
    "clocking": ("0.1 rad", {"clocking": 0.1}),
    "noise": ("7 nm", {"noise_nm": 7.0}),
    "free": (["z", "rotation"], {"free": ("z", "rotation")}),
}
DIAGNOSED = {
    "noise": ("7 nm", {"noise_nm": [7.0]}),
    "error_sources": (["offset x"], {"error_sources": ("offset x",)}),
    "waviness": ([3, 4], {"waviness": (3, 4)}),
    "min_effect": ("2 nm", {"min_effect_nm": 2.0}),
    "correct": (["offset x"], {"correct": ("offset x",)}),
    "repeats": (False, {"repeats": False}),
    "fixed": (["clocking"], {"free": ["piston", "tilt", "decentre"]}),
    "reference": ("best-fit sphere", {"reference": "best-fit sphere"}),
}
CORRECTED = {"min_effect": ("2 nm", 2e-6), "cutoff": ("0.5 mm", 0.5), "repeats": (False, False)}


def _asks(monkeypatch, module, stage, arguments):
    """Return what a stage of a command is asked, which goes no further."""
    calls = []

    def asked(*given, **named):
        calls.append((given, named))
        raise tw.InputError("this is far enough")

    with monkeypatch.context() as patch:
        patch.setattr(module, stage, asked)
        assert main(arguments) == 2
    return calls[0]


@pytest.mark.parametrize("command", ["measure", "diagnose", "correct"])
def test_every_command_registers_by_the_keys_of_the_measurement(shop, tmp_path, monkeypatch, command):
    keys = [f"{key}={value}" for key, (value, _) in REGISTERED.items()]
    arguments = [command, str(shop / "dish.x3p"), "--job", str(shop / "job.toml"), "--out", str(tmp_path / "out")]
    arguments += [word for key in keys for word in ("--set", key)]
    _, named = _asks(monkeypatch, _measure, "register", arguments)
    for key, (_, options) in REGISTERED.items():
        for name, value in options.items():
            assert named[name] == pytest.approx(value) if isinstance(value, float) else named[name] == value, key


@pytest.mark.parametrize("command", ["diagnose", "correct"])
def test_every_command_diagnoses_by_the_keys_of_the_measurement(shop, tmp_path, monkeypatch, command):
    table = {"measurement": {key: value for key, (value, _) in DIAGNOSED.items()}}
    job = written(tmp_path, *DISH, *table.items())
    monkeypatch.setattr(_measure, "_diagnose_all", DIAGNOSE)
    arguments = [command, str(shop / "dish.x3p"), "--job", str(job), "--out", str(tmp_path / "out")]
    _, named = _asks(monkeypatch, _measure, "attribute", arguments)
    for key, (_, options) in DIAGNOSED.items():
        for name, value in options.items():
            assert named[name] == pytest.approx(value) if key in ("noise", "min_effect") else named[name] == value, key


@pytest.mark.parametrize("of", [[], ["--of", "job.toml"]])
def test_a_correction_is_by_the_keys_of_the_measurement(shop, tmp_path, monkeypatch, of):
    """Of the job that is corrected, too, if that is another one."""
    keys = [f"{key}={str(value).lower()}" for key, (value, _) in CORRECTED.items()]
    arguments = ["correct", str(shop / "dish.x3p"), "--job", str(shop / "job.toml"), "--out", str(tmp_path / "out")]
    arguments += [str(shop / one) if one.endswith(".toml") else one for one in of]
    arguments += [word for key in keys for word in ("--set", key)]
    (job, *_), _ = _asks(monkeypatch, tw.job, "correct", arguments)
    for key, (_, value) in CORRECTED.items():
        assert getattr(job.measurement, key) == value
