"""What `turnwright measure` says of a polar map. Oracle: closed forms of Zernike polynomials over the disc."""

import re

import numpy as np
import pytest

import turnwright as tw
from job_files import written
from turnwright.cli import main
from turnwright.job import Job, measure

HEIGHT = 50.0  # at the rim [nm]

FORMS = {
    "defocus": (lambda rho, _angle: 2 * rho**2 - 1, 1 / np.sqrt(3)),
    "trefoil": (lambda rho, angle: rho**3 * np.cos(3 * angle), 1 / np.sqrt(8)),
    "coma": (lambda rho, angle: (3 * rho**3 - 2 * rho) * np.sin(angle), 1 / np.sqrt(8)),
}


def measured_map(folder, form):
    job = written(
        folder,
        ("part.radius", "1 mm"),
        ("part.surface", {"family": "toroid", "radius_x": "20 mm", "radius_y": "30 mm"}),
        ("simulation.patches", []),
        # What a shift or a turn of the toroid passes for is not in the closed forms.
        ("measurement.fixed", ["decentre", "clocking"]),
    )
    radius, angle = np.linspace(0, 1, 101), np.linspace(0, 2 * np.pi, 180, endpoint=False)
    x, y = radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None]
    error = HEIGHT * 1e-6 * FORMS[form][0](radius, angle[:, None])
    surface = Job.load(job).part.surface
    return job, tw.HeightMap(radius=radius, angle=angle, z=surface.sag(x, y) + error)


def test_the_rms_of_a_polar_map_is_that_over_its_area(tmp_path, capsys):
    job, heights = measured_map(tmp_path, "trefoil")
    tw.write_map(heights, tmp_path / "polar.npz")
    assert main(["measure", str(tmp_path / "polar.npz"), "--job", str(job), "--out", str(tmp_path / "out")]) == 0
    (rms,) = re.findall(r"rms ([\d.]+) nm", capsys.readouterr().out)
    assert float(rms) == pytest.approx(HEIGHT / np.sqrt(8), rel=1e-3)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"{rms} nm, over the clear aperture" in page
    assert "17.7 nm rms" in page  # below the map of the error


@pytest.mark.parametrize("form", FORMS)
def test_a_polar_map_is_registered_over_its_area(form, tmp_path):
    """Piston and tilt are orthogonal to these forms over the area, not over the points: the pose stays where it is."""
    job, heights = measured_map(tmp_path, form)
    found = measure(Job.load(job), heights)
    exact = HEIGHT * FORMS[form][1]
    assert found.form_rms_nm == pytest.approx(exact, rel=2e-3)
    assert found.registration.rms_nm == pytest.approx(exact, rel=2e-3)
