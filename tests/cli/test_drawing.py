"""Call-outs of a drawing from the job file to the certificate. Oracle: a map made of Zernike terms, by hand."""

import hashlib
import html
import json
import re
from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
from job_files import written
from turnwright.cli import main
from turnwright.files import write_map
from turnwright.job import Job, measure
from turnwright.report import write_certificate

FORM = "3/ 0,5(0,2/0,1) RMSi < 0,05; λ = 546,07 nm"
"""A 136.5, B 54.6, C 27.3, RMSi 13.65 nm."""

FLAT = (
    ("part", {"name": "flat", "radius": "2 mm", "surface": {"family": "plane"}}),
    ("simulation", {"whole_part": {"radii": 40, "angles": 36}}),
    ("strategy", {"kind": "slow tool servo", "feed": "10 um/rev", "points_per_rev": 360, "spindle_speed": "60 rpm"}),
)
TERMS = {4: 40e-6, 5: 20e-6, 9: 10e-6}
"""A 80, B 46.67, C 15, RMSi 9.31 nm, see the how-to."""


def plate(radius=2.0, factor=1.0):
    x = np.linspace(-radius, radius, 121)
    z = factor * tw.Zernike(terms=TERMS, radius=2.0, indexing="fringe").sag(*np.meshgrid(x, x))
    return tw.HeightMap(x=x, y=x, z=np.where(np.hypot(x, x[:, None]) <= radius, z, np.nan), name="plate")


def measured(drawing, heights, **measurement):
    table = {"free": ["z", "tilt_x", "tilt_y"], "outliers": "none", **measurement}
    job = Job.read(
        {
            **dict(FLAT),
            "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
            "machine": {"name": "generic"},
            "tolerances": {"drawing": drawing},
            "measurement": table,
        }
    )
    return measure(job, heights)


def judged(drawing, heights, **measurement):
    return measured(drawing, heights, **measurement).verdicts


def test_a_measured_map_is_judged_by_its_call_out():
    found = {one.quantity: one for one in judged([FORM], plate())}
    for symbol, value in {"A": 80, "C": 15, "RMSi": np.sqrt(260 / 3)}.items():
        assert found[symbol].value == pytest.approx(value, rel=1e-3)
    assert found["B"].value == pytest.approx(30 + 50 / 3, rel=1e-3)
    assert found["B"].limit == pytest.approx(0.1 * 546.07)
    assert all(one.is_kept and one.uncertainty is None for one in found.values())
    missed = {one.quantity: one.is_kept for one in judged([FORM], plate(factor=1.5))}
    assert missed == {"A": True, "B": False, "C": True, "RMSi": False}


def noisy(noise, seed=4):
    """Return the verdicts by quantity on the plate with noise of its heights [nm]."""
    made = plate()
    z = made.z + 1e-6 * noise * np.random.default_rng(seed).normal(size=made.z.shape)
    return {one.quantity: one for one in judged([FORM], replace(made, z=z), noise=f"{noise} nm")}


def test_uncertainty_of_a_noisy_form_covers_the_truth():
    """Independent noise of 6 nm: its bias is no form error, and 95 % of the values are within their uncertainty."""
    truth = {"A": 80, "B": 30 + 50 / 3, "C": 15, "RMSi": np.sqrt(260 / 3)}
    off = [
        abs(verdicts[symbol].value - value) / verdicts[symbol].uncertainty
        for verdicts in (noisy(6, seed) for seed in range(5))
        for symbol, value in truth.items()
    ]
    assert np.count_nonzero(np.array(off) > 1) <= 3
    assert max(off) < 1.5
    assert noisy(6)["RMSi"].value == pytest.approx(truth["RMSi"], rel=0.05)


@pytest.mark.parametrize("call_out", ["Sq 1 nm; 0.2/1", "slope < 0.05 mrad; 0.5", "PSD 1e-3 nm² mm/1; 0.2/1"])
def test_noise_alone_is_no_nonconformity_of_texture(call_out):
    """A perfect flat with 5 nm of stated noise."""
    x = np.linspace(-2, 2, 161)
    z = np.where(np.hypot(x, x[:, None]) <= 2, 5e-6 * np.random.default_rng(2).normal(size=(161, 161)), np.nan)
    (verdict,) = judged([call_out], tw.HeightMap(x=x, y=x, z=z), noise="5 nm")
    assert verdict.value > verdict.limit
    assert verdict.is_kept is None


def test_a_limit_within_the_uncertainty_is_not_decided():
    """ISO 14253-1: B is 46.67 nm, its limit 54.61."""
    within, beyond = (
        next(one for one in judged([FORM], plate(), noise="0.1 nm", calibration=calibration) if one.quantity == "B")
        for calibration in ("7 nm", "9 nm")
    )
    assert within.uncertainty == pytest.approx(7, rel=0.02)
    assert within.is_kept is True
    assert beyond.is_kept is None
    assert "neither conforming nor nonconforming" in beyond.sentence


def test_part_of_a_surface_proves_only_that_a_limit_is_missed():
    for limit, is_kept in (("9 mrad", None), ("1 urad", False)):
        (verdict,) = judged([f"slope < {limit}; 0.5"], plate(radius=1.5))
        assert verdict.is_kept is is_kept
        assert verdict.value is not None


def test_a_map_smaller_than_the_part_is_not_judged():
    verdicts = judged([FORM, "Sq 2 nm; 0.001/0.1"], plate(radius=1.5))
    assert all(one.is_kept is None for one in verdicts)
    assert "smaller than the clear aperture" in verdicts[0].sentence
    assert "resolves" in verdicts[-1].sentence


def test_a_sphere_of_unknown_radius_has_no_sagitta_error():
    found = {one.quantity: one for one in judged([FORM], plate(), reference="best-fit sphere")}
    assert found["A"].value is None
    assert "unknown radius" in found["A"].sentence
    assert found["C"].value == pytest.approx(15, rel=1e-3)


@pytest.mark.parametrize(
    ("drawing", "words"),
    [
        (["3/ 0.5(0.2/0.1); λ = 546"], "write λ = 546 nm"),
        (["3/ 0.5(0.2/0.3); λ = 546 nm"], "C never exceeds B"),
        ([FORM, "3/ 1; λ = 546 nm"], "state one limit"),
    ],
)
def test_a_wrong_drawing_ends_with_one_sentence(tmp_path, capsys, drawing, words):
    job = written(tmp_path, *FLAT, ("tolerances", {"drawing": drawing}))
    assert main(["check", str(job)]) == 2
    message = capsys.readouterr().err
    assert words in message
    assert "Traceback" not in message


def text_of(page):
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<style>.*?</style>|<[^>]*>", " ", page, flags=re.DOTALL)))


def test_measure_writes_a_certificate(tmp_path):
    mask = np.ones((121, 121))
    mask[50:52, 50:52] = np.nan
    write_map(tw.HeightMap(x=np.arange(121.0), y=np.arange(121.0), z=mask), tmp_path / "mask.npz")
    settings = {
        "free": ["z", "tilt_x", "tilt_y"], "calibration": "1 nm", "mask": "mask.npz",
        "instrument": {"noise": "0.2 nm"}, "trim": "0.01 mm",
    }  # fmt: skip
    job = written(tmp_path, *FLAT, ("tolerances", {"drawing": [FORM]}), ("measurement", settings))
    file, out = tmp_path / "plate.x3p", tmp_path / "out"
    write_map(plate(factor=1.5), file)
    assert main(["measure", str(file), "--job", str(job), "--out", str(out)]) == 4
    verdicts = json.loads((out / "measured.json").read_text())["verdicts"]
    assert {one["quantity"]: one["kept"] for one in verdicts} == {"A": True, "B": False, "C": True, "RMSi": None}
    page = (out / "certificate.html").read_text(encoding="utf-8")
    assert "@page { size: A4" in page
    assert "<h2>Job</h2>" not in page
    text = text_of(page)
    for expected in (
        "Nonconforming", FORM, "136.5 nm", "unnamed (noise 0.2 nm)", "file mask.npz; edge of 10 um left out",
        "outliers removed", "z, tilt_x, tilt_y fitted", "noise of a height 0.2 nm",
        "calibration of the instrument (k = 2) 1 nm",
        hashlib.sha256(file.read_bytes()).hexdigest()[:16], "Signature", "along the normal",
    ):  # fmt: skip
        assert expected in text, expected


def test_a_certificate_without_a_tolerance_is_not_written(tmp_path):
    assert write_certificate(measured([FORM], plate()), tmp_path) == tmp_path / "certificate.html"
    assert "Conforming" in text_of((tmp_path / "certificate.html").read_text(encoding="utf-8"))
    assert write_certificate(measured([], plate()), tmp_path / "none.html") is None


def test_run_judges_the_predicted_part(tmp_path, capsys):
    """A flat with cusps of f^2 / 8R = 25 nm, on the axis 9/4 of it: B; RMSi is sqrt(4/45) of them, and A nothing."""
    patch = {"name": "middle", "centre": ["1 mm", "0 mm"], "size": ["0.2 mm", "0.2 mm"], "pixel": "0.5 um"}
    drawing = [FORM, "Sq 8 nm; 0.002/0.1", "0.0025-0.025 / Rz 0.02"]
    job = written(
        tmp_path, *FLAT, ("tolerances", {"drawing": drawing}), ("simulation.patches", [patch]),
    )  # fmt: skip
    out = tmp_path / "out"
    assert main(["run", str(job), "--out", str(out)]) == 4
    found = {one["quantity"]: one for one in json.loads((out / "result.json").read_text())["verdicts"]}
    cusp = 0.01**2 / (8 * 0.5) * 1e6
    assert found["RMSi"]["value"] == pytest.approx(cusp * np.sqrt(4 / 45), rel=0.02)
    assert found["A"]["value"] < 0.5
    assert found["B"]["value"] == pytest.approx(9 / 4 * cusp, rel=0.02)
    assert found["Sq"]["value"] == pytest.approx(cusp * np.sqrt(4 / 45), rel=0.02)
    assert (found["Sq"]["place"], found["Rz"]["kept"]) == ("middle", False)
    assert "certificate" in capsys.readouterr().out
    assert "predicted from the program" in text_of((out / "certificate.html").read_text(encoding="utf-8"))
