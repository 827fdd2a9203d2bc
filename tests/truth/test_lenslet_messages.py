"""What lenslets refuse, in one sentence."""

import numpy as np
import pytest

import turnwright as tw
from turnwright.errors import InputError
from turnwright.metrology import has_lenslets
from turnwright.report.figures import dislocation_map

SPHERE = tw.Sphere(radius=5.0)
ARRAY = tw.LensArray.square(pitch=1.0, rows=2, columns=2, lenslet=SPHERE, aperture=0.4, surround=0.0)
X = np.linspace(-1, 1, 101)


def flat(z=0.0):
    return tw.HeightMap(x=X, y=X, z=np.full((101, 101), z))


def found(surface, heights=None, **options):
    options = {"pose": tw.Pose(), **options}
    return tw.lenslets(flat() if heights is None else heights, tw.Part(surface=surface, radius=1.0), **options)


def test_a_part_without_an_array_or_with_two_is_refused():
    with pytest.raises(InputError, match="a Sphere, has 0 lens arrays, it must have 1"):
        found(SPHERE)
    with pytest.raises(InputError, match="a Sum, has 2 lens arrays"):
        found(ARRAY + ARRAY)
    assert has_lenslets(SPHERE + ARRAY.placed(rotation=1.0))
    assert not has_lenslets(ARRAY + ARRAY)
    assert not has_lenslets(SPHERE)


def test_an_array_tilted_against_its_base_is_refused():
    with pytest.raises(InputError, match=r"tilted against its base .* place base and array together"):
        found(SPHERE + tw.LensArray(centres=[[0, 0]], lenslet=SPHERE).placed(tilt=(0.01, 0.0)))


def test_a_form_without_centre_or_sphere_is_refused():
    wedge = tw.LensArray(centres=[[0, 0]], lenslet=tw.Plane(slope=(0.1, 0.0)))
    with pytest.raises(InputError, match=r"does not determine the centre along ."):
        found(wedge)
    with pytest.raises(InputError, match="curvature at its vertex is 0 per mm"):
        found(wedge, form="sphere")


def test_a_tilt_that_is_a_shift_is_refused():
    with pytest.raises(InputError, match=r"squared effect .* at least 0.0001 is needed; leave the tilt fixed"):
        found(ARRAY, tilt=True)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"inner": 1.2}, "inner, the fraction of its radius"),
        ({"outer": 0.9}, "outer, where the base begins"),
        ({"form": "cone"}, "form is 'cone'"),
        ({"aperture": -1.0}, "aperture of a lenslet is -1 mm"),
    ],
)
def test_options_out_of_range_are_named(options, words):
    with pytest.raises(InputError, match=words):
        found(ARRAY, **options)


def test_maps_that_hold_nothing_of_the_part_are_refused():
    with pytest.raises(InputError, match="has 0 valid heights"):
        found(ARRAY, flat(np.nan))
    with pytest.raises(
        InputError, match="none of the 10201 valid points of the map lie within the clear aperture, radius 1 mm"
    ):
        found(ARRAY, pose=tw.Pose(shift=(50, 0, 0)))
    pixels = tw.HeightMap(x=X, y=X, z=np.zeros((101, 101)), calibrated=False)
    with pytest.raises(InputError, match="no pixel size"):
        found(ARRAY, pixels)


def test_an_alignment_needs_two_places():
    with pytest.raises(InputError, match=r"have the shapes \(1, 2\) and \(1, 2\)"):
        tw.metrology.Alignment.of([[0, 0]], [[0, 0]])
    with pytest.raises(InputError, match="the design centres coincide"):
        tw.metrology.Alignment.of([[0, 0], [0, 0]], [[0, 0], [1, 0]])


def test_missing_array_is_reported_by_lenslet_and_drawn():
    lost = found(ARRAY)
    assert not lost.measured.any()
    assert len(lost.findings) == 4
    assert lost.findings[0].startswith("lens 1 at (-0.5, -0.5) mm: ")
    assert lost.alignment is None
    assert np.isnan(lost.irregular).all()
    assert "4 lenslets could not be fitted" in dislocation_map(lost).alt
    made = tw.HeightMap(x=X, y=X, z=ARRAY.placed(rotation=1e-3).sag(X, X[:, None]))
    picture = dislocation_map(found(ARRAY, made, level=False))
    assert "0.707 µm rms" in picture.alt
    assert "without rotation 1000 µrad" in picture.alt
    assert picture.svg.startswith("<svg")


def test_scan_of_some_lenslets_reports_an_ambiguous_pitch():
    array = tw.LensArray.square(pitch=1.0, rows=4, columns=4, lenslet=SPHERE, aperture=0.4, surround=0.0)
    some = tw.HeightMap(x=X, y=X, z=array.sag(X, X[:, None]))
    frame = tw.lenslets(some, tw.Part(surface=array, radius=3.0)).frame
    assert "other poses fit nearly as well" in frame
