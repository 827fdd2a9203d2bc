"""Sag tables as a surface of a job: all that `read_map` reads, with units, against the surface that they hold."""

import numpy as np
import pytest

import turnwright as tw
from job_files import changed
from turnwright.errors import JobError
from turnwright.job import Job

DISH = tw.Conic(radius=40.0, conic=-0.8)
AXIS = np.linspace(-2, 2, 33)
X, Y = np.meshgrid(AXIS, AXIS)
Z = DISH.sag(X, Y)


def comma(value):
    return f"{value:.12f}".replace(".", ",")


def points(*, scale=1.0, sign=".", between=";", head=""):
    rows = zip(X.ravel(), Y.ravel(), (Z * scale).ravel(), strict=True)
    return head + "\n".join(between.join(f"{one:.12f}".replace(".", sign) for one in row) for row in rows)


def crossed(*, between, sign=".", head="", order=1):
    rows = [[y, *row] for y, row in zip(AXIS[::order], Z[::order] * 1e3, strict=True)]
    lines = [between.join([head, *(f"{one:.12f}".replace(".", sign) for one in AXIS)])]
    lines += [between.join(f"{one:.12f}".replace(".", sign) for one in row) for row in rows]
    return "\n".join(lines)


def grid_sag():
    """ncols nrows dx dy unit (cm) xdec ydec, then z dz/dx dz/dy d2z, the first point at -x and +y."""
    step = float(AXIS[1] - AXIS[0]) / 10
    return "\n".join([f"33 33 {step!r} {step!r} 1 0 0", *(f"{z / 10:.14f} 0 0 0" for z in Z[::-1].ravel())])


def scattered():
    rng = np.random.default_rng(2)
    radius, angle = 2 * np.sqrt(rng.uniform(0, 1, 600)), rng.uniform(0, 2 * np.pi, 600)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return "x [mm],y [mm],z [um]\n" + "\n".join(
        f"{a:.9f},{b:.9f},{1e3 * c:.9f}" for a, b, c in zip(x, y, DISH.sag(x, y), strict=True)
    )


FILES = {
    "a list with its units": ("a.csv", points(head="x [mm];y [mm];z [mm]\n"), {}),
    "a list in micrometres": ("a.csv", points(scale=1e3, between=","), {"units": "mm", "sag_units": "um"}),
    "a list with decimal commas": ("a.txt", points(sign=",", between="\t"), {"units": "mm", "sag_units": "mm"}),
    "x in the first row": ("a.csv", crossed(between=",", head="y/x"), {"units": "mm", "sag_units": "um"}),
    "x in the first row, falling": ("a.csv", crossed(between=";", order=-1), {"units": "mm", "sag_units": "um"}),
    "x in the first row, commas": ("a.csv", crossed(between=";", sign=","), {"units": "mm", "sag_units": "um"}),
    "Zemax grid sag": ("a.dat", grid_sag(), {}),
    "scattered points": ("a.csv", scattered(), {}),
}


@pytest.mark.parametrize("kind", FILES)
def test_a_table_of_any_kind_is_the_surface_that_it_holds(tmp_path, kind):
    name, text, keys = FILES[kind]
    (tmp_path / name).write_text(text, encoding="utf-8")
    table = {"family": "gridded", "file": name, **keys}
    job = Job.read(changed(("part.surface", table)), folder=tmp_path)
    x, y = np.random.default_rng(1).uniform(-1.2, 1.2, (2, 500))
    np.testing.assert_allclose(job.part.surface.sag(x, y), DISH.sag(x, y), atol=2e-8)
    upside = Job.read(changed(("part.surface", {**table, "inverted": True})), folder=tmp_path)
    np.testing.assert_allclose(upside.part.surface.sag(x, y), -DISH.sag(x, y), atol=2e-8)


@pytest.mark.parametrize("kind", ["map.npz", "map.x3p", "map.grd"])
def test_an_instrument_s_file_is_a_surface_too(tmp_path, kind):
    tw.write_map(tw.HeightMap(x=AXIS, y=AXIS, z=Z), tmp_path / kind)
    job = Job.read(changed(("part.surface", {"family": "gridded", "file": kind, "placed": {"rotation": "90 deg"}})),
                   folder=tmp_path)  # fmt: skip
    x, y = np.random.default_rng(1).uniform(-1.2, 1.2, (2, 500))
    surface = job.part.surface
    np.testing.assert_allclose(surface.sag(x, y), DISH.sag(x, y), atol=2e-8)


@pytest.mark.parametrize(
    ("text", "keys", "match"),
    [
        (points(), {"sag_units": "mm"}, r"does not state the unit of x: give it as units = 'mm' in the job"),
        (points(), {"units": "mm"}, r"does not state the unit of z: give it as sag_units = 'mm' in the job"),
        (points(head="x [mm];y [mm];z [um]\n"), {"sag_units": "mm"}, r"states the unit of its heights, um"),
        (crossed(between=",").replace("0.125", "0.125,7", 1), {"units": "mm", "sag_units": "um"}, "a.csv"),
        ("\n".join(" ".join(f"{one:.9f}" for one in row) for row in Z), {"sag_units": "mm"}, "state pixel_size"),
    ],
)
def test_a_table_that_leaves_something_open_is_refused(tmp_path, text, keys, match):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with pytest.raises(JobError, match=match):
        Job.read(changed(("part.surface", {"family": "gridded", "file": "a.csv", **keys})), folder=tmp_path)


def test_a_changed_table_is_read_again(tmp_path):
    file = tmp_path / "a.csv"
    job = changed(("part.surface", {"family": "gridded", "file": "a.csv", "units": "mm", "sag_units": "mm"}))
    file.write_text(points(between=","), encoding="utf-8")
    first = Job.read(job, folder=tmp_path).part.surface.sag(1.0, 0.5)
    file.write_text(points(between=",", scale=-0.5), encoding="utf-8")
    assert Job.read(job, folder=tmp_path).part.surface.sag(1.0, 0.5) == pytest.approx(-0.5 * first, rel=1e-9)
