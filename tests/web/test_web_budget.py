"""What the workbench tells of a finished run: the chips along its path, and where its error comes from."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import turnwright as tw
from turnwright.cutting.chip import RoundChip
from turnwright.job import break_down_error
from turnwright.report import archive_run

pytest.importorskip("fastapi", reason="the workbench is an extra: pip install 'turnwright[web]'")

from fastapi.testclient import TestClient

from turnwright.web import budget as _budget, create_app, results as _made
from turnwright.web.binary import MEDIA_TYPE, unpack

RUN = "0123456789abcdef"
FEED, NOSE, STOCK = 0.020, 0.5, 0.020

FLAT = {
    "part": {"surface": {"family": "plane"}, "radius": "2 mm", "stock": "20 um", "material": "IRG 26"},
    "tool": {"nose_radius": "0.5 mm", "included": "100 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {
        "kind": "slow tool servo", "feed": "20 um/rev", "points_per_rev": 90, "spindle_speed": "60 rpm",
        "lead_in": "0.3 mm",
    },
    "simulation": {"whole_part": {"radii": 101, "angles": 60}, "patches": []},
}  # fmt: skip


def carried_out(data: dict, folder: Path) -> tuple[Path, tw.job.Result]:
    """Carry out a job into the folder of a run, as the command line does."""
    out = folder / "runs" / RUN / "out"
    out.mkdir(parents=True)
    result = tw.run(tw.Job.read(data), out=out)
    archive_run(result, out)
    return out, result


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tw.job.Result]:
    return carried_out(FLAT, tmp_path_factory.mktemp("server"))


def test_the_chips_of_a_run_are_those_found_along_its_path(made: tuple[Path, tw.job.Result]) -> None:
    """Oracles: the map of the run point by point by brute force, and the round chip of a flat."""
    out, result = made
    header, arrays = unpack(_made.chips(str(out), 33))
    chips = result.chips["finish"]
    inside = chips.inside
    axis = np.linspace(-2, 2, 33)
    x, y = np.meshgrid(axis, axis)
    within = np.hypot(x, y) < 1.99
    apart = np.hypot(x[within][:, None] - chips.x[inside], y[within][:, None] - chips.y[inside])
    nearest = chips.thickness[inside][apart.argmin(axis=1)]
    np.testing.assert_allclose(arrays["values"][within], nearest, rtol=1e-6)
    assert (header["unit"], header["points"], header["radius"]) == ("mm", int(inside.sum()), 2.0)
    assert header["high"] == pytest.approx(chips.thickest, rel=1e-12)
    flat = RoundChip(nose_radius=NOSE, depth=STOCK, feed=FEED).thickest
    ring = within & (np.hypot(x, y) > 0.3) & (np.hypot(x, y) < 1.5)
    np.testing.assert_allclose(arrays["values"][ring], flat, rtol=0.02)
    assert result.passes[-1].chips is not None
    assert result.passes[-1].chips.sentence in header["note"]


def test_the_budget_of_a_run_is_that_of_the_comparison(made: tuple[Path, tw.job.Result]) -> None:
    """Oracles: the cusps of a flat in closed form, and `break_down_error` of the planned motion, not read back."""
    out, result = made
    found = _budget.budget(str(out))
    assert found["cusp_away_nm"] == pytest.approx((NOSE - np.sqrt(NOSE**2 - FEED**2 / 4)) * 1e6, rel=0.02)
    job = result.job
    servo = job.servo(job.passes[-1])
    spiral = servo.spiral(job.part.aimed, job.tool)
    motion = tw.drive(tw.place(spiral, job.part.aimed, job.tool), servo, job.machine)
    reported = break_down_error(job.part.aimed, job.tool, spiral, motion)
    assert found["cusp_nm"] == pytest.approx(reported.cusp_nm, rel=1e-9)
    assert found["pv_nm"] == pytest.approx(reported.pv_nm, abs=2 * result.rounding_limit_nm)
    assert abs(found["chord_nm"] - reported.chord_nm) <= 2 * result.rounding_limit_nm
    assert found["rounding_nm"] == result.rounding_nm
    assert found["servos"] is False
    assert {*found} == {one.name for one in fields(tw.job.ErrorBreakdown)} - {"error"} | {"servos"}
    kept = out.parent / _budget.CACHE_FILE
    assert json.loads(kept.read_text(encoding="utf-8")) == found
    assert _budget.budget(str(out)) == found
    assert sorted(file.name for file in out.parent.iterdir()) == [_budget.CACHE_FILE, "out"]


def test_the_routes_answer_and_say_what_is_missing(made: tuple[Path, tw.job.Result], tmp_path: Path) -> None:
    soft = FLAT | {"part": {**FLAT["part"], "radius": "0.5 mm", "material": "copper", "stock": "0 um"}}
    out, _ = carried_out(soft, tmp_path)
    with TestClient(create_app(made[0].parents[2]), base_url="http://127.0.0.1") as client:
        answer = client.get(f"/api/runs/{RUN}/chips?pixels=33")
        assert (answer.status_code, answer.headers["content-type"]) == (200, MEDIA_TYPE)
        assert unpack(answer.content)[1]["values"].shape == (33, 33)
        assert client.get(f"/api/runs/{RUN}/chips?pixels=5000").status_code == 422
        assert client.get(f"/api/runs/{RUN}/budget").json() == _budget.budget(str(made[0]))
        for what in ("chips", "budget"):
            assert client.get(f"/api/runs/{'0' * 16}/{what}").status_code == 404
    with pytest.raises(tw.InputError, match="stock and the material"):
        _made.chips(str(out), 33)
    (out / "run.h5").write_bytes(b"")
    with pytest.raises(tw.InputError, match=r"run.*again"):
        _made.chips(str(out), 33)
    (out / "result.json").write_text('{"program": {"files": []}, "passes": []}', encoding="utf-8")
    with pytest.raises(tw.InputError, match="no program"):
        _budget.budget(str(out))
