"""Maps of departures from a reference, against the form that was put on the part."""

import numpy as np
import pytest

import turnwright as tw
from cases import every_second
from job_files import changed, written
from turnwright.cli import main
from turnwright.errors import JobError, MapError
from turnwright.job import Job, measure, read_measurement

DISH = tw.Sphere(radius=20.0)
TREFOIL = tw.Zernike(terms={10: 2e-4}, radius=2.0, indexing="fringe")
AXIS = np.linspace(-1.95, 1.95, 79)
X, Y = np.meshgrid(AXIS, AXIS)
ON = np.hypot(X, Y) < 1.94


def asked(**keys):
    return [
        ("part.surface", {"family": "sphere", "radius": "20 mm"}), ("part.radius", "2 mm"), ("simulation.patches", []),
        ("measurement", keys),
    ]  # fmt: skip


def seen(z, *, shift=0.0):
    return tw.HeightMap(x=AXIS + shift, y=AXIS + shift, z=np.where(ON, z, np.nan), name="seen")


def cosine():
    zx, zy = DISH.gradient(X, Y)
    return 1 / np.sqrt(1 + zx**2 + zy**2)


SPHERE = {"family": "sphere", "radius": "20.02 mm"}
MAPS = {
    "heights": (DISH.sag(X, Y) + TREFOIL.sag(X, Y), {}),
    "null test": (TREFOIL.sag(X, Y), {"quantity": "departure", "departure_from": "design"}),
    "along the normal": (
        TREFOIL.sag(X, Y) * cosine(), {"quantity": "departure, along the normal", "departure_from": "design"}
    ),
    "from a sphere": (
        DISH.sag(X, Y) + TREFOIL.sag(X, Y) - tw.Sphere(radius=20.02).sag(X, Y),
        {"quantity": "departure", "departure_from": SPHERE},
    ),
}  # fmt: skip


@pytest.mark.parametrize(("kind", "shift"), every_second(MAPS, [0.0, 7.0]))
def test_a_departure_is_the_form_that_the_heights_show(kind, shift):
    """The map lies about its origin, or counts its pixels from a corner."""
    z, keys = MAPS[kind]
    found = measure(Job.read(changed(*asked(**keys))), seen(z, shift=shift))
    x, y = found.error.points()
    np.testing.assert_allclose(found.error.z, TREFOIL.sag(x, y), atol=2e-7)
    assert found.form_rms_nm == pytest.approx(1e6 * np.sqrt(np.mean(TREFOIL.sag(X[ON], Y[ON]) ** 2)), rel=2e-3)


def test_a_departure_needs_what_it_counts_from():
    for keys in ({"quantity": "departure"}, {"departure_from": "design"}):
        with pytest.raises(JobError, match=r"quantity is .* and departure_from is"):
            Job.read(changed(*asked(**keys)))


def test_unit_of_a_departure_map_is_set_by_key_or_option(tmp_path, capsys):
    """Oracle: the rms of the form, which is a thousand times as large in another unit."""
    file = tmp_path / "seen.csv"
    rows = np.stack([X[ON], Y[ON], 1e3 * TREFOIL.sag(X[ON], Y[ON])], axis=1)
    np.savetxt(file, rows, delimiter=",")
    keys = {"quantity": "departure", "departure_from": "design", "units": "mm"}
    job = str(written(tmp_path, *asked(**keys)))
    assert main(["measure", str(file), "--job", job, "--out", str(tmp_path / "no")]) == 2
    assert "does not state the unit of z" in capsys.readouterr().err
    assert main(["measure", str(file), "--job", job, "--unit", "um", "--out", str(tmp_path / "option")]) == 0
    by_option = capsys.readouterr().out.splitlines()[0]
    job = str(written(tmp_path, *asked(**keys, sag_units="um")))
    assert main(["measure", str(file), "--job", job, "--out", str(tmp_path / "key")]) == 0
    assert capsys.readouterr().out.splitlines()[0] == by_option
    rms = float(by_option.partition("rms ")[2].partition(" nm")[0])
    assert rms == pytest.approx(1e6 * np.sqrt(np.mean(TREFOIL.sag(X[ON], Y[ON]) ** 2)), rel=5e-3)


@pytest.mark.parametrize(
    ("head", "keys", "key"),
    [
        ("x,y,z", {}, "units = 'mm'"),
        ("x [mm],y [mm],z", {}, "sag_units = 'mm'"),
        ("x,y,z", {"units": "mm"}, "sag_units"),
    ],
)
def test_a_missing_unit_is_requested_by_its_key(tmp_path, head, keys, key):
    file = tmp_path / "bare.csv"
    rows = [f"{x:.3f},{y:.3f},0.001" for x, y in zip(X[ON], Y[ON], strict=True)]
    file.write_text("\n".join([head, *rows]))
    with pytest.raises(MapError) as refused:
        read_measurement(Job.read(changed(*asked(**keys))), file)
    assert f"{key}" in str(refused.value)
    assert "[measurement]" in str(refused.value)
