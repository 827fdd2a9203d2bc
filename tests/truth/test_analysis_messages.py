"""What the analysis of a map refuses, in one sentence with the remedy."""

import numpy as np
import pytest

from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import (
    area_psd,
    bearing,
    best_fit,
    fit_zernike,
    interferogram,
    line_profile,
    line_psd,
    slope_error,
)
from turnwright.profile import Profile
from turnwright.surface import Plane

X = np.linspace(-1, 1, 21)
Z = np.random.default_rng(0).standard_normal((21, 21)) * 1e-4
MAP = HeightMap(x=X, y=X, z=Z)
POLAR = HeightMap(radius=X + 1, angle=np.linspace(0, 6, 21), z=Z)
UNEVEN = HeightMap(x=X**3, y=X, z=Z)
EMPTY = HeightMap(x=X, y=X, z=np.full((21, 21), np.nan))
PIXELS = HeightMap(x=X, y=X, z=Z, calibrated=False)
SCATTERED = HeightMap(x=X, y=X, z=Z[0])
LINE = Profile(distance=X, z=Z[0], x=X, y=X)


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda: fit_zernike(MAP, terms=0, indexing="noll"), "0 Zernike terms are requested, at least 1"),
        (lambda: fit_zernike(MAP, terms=10**12, indexing="noll"), "Zernike terms are requested, the limit is 1000"),
        (lambda: fit_zernike(MAP, terms=[4, 4], indexing="noll"), "given twice"),
        (lambda: fit_zernike(MAP, terms=[37, 49], indexing="fringe"), "both the polynomial"),
        (lambda: fit_zernike(MAP, terms=3, indexing="zemax"), "known are fringe, noll and ansi"),
        (lambda: fit_zernike(EMPTY, terms=3, indexing="noll"), "has 0 valid heights, a fit of 3 Zernike terms needs 3"),
        (lambda: fit_zernike(MAP, terms=9, indexing="noll", radius=0.1), "has 5 valid heights, 9 Zernike terms need"),
        (lambda: fit_zernike(MAP, terms=9, indexing="noll", radius=-1), "the radius of the aperture is -1 mm"),
        (lambda: fit_zernike(MAP, terms=9, indexing="noll", centre=(0, np.nan)), "the centre of the aperture"),
        (lambda: fit_zernike(PIXELS, terms=9, indexing="noll"), "give the pixel size"),
        (lambda: fit_zernike(SCATTERED, terms=6, indexing="noll"), "cannot separate noll .* of a Zernike fit"),
        (lambda: best_fit(MAP, "cone"), 'it must be "plane", "sphere", "conic", or a Sphere'),
        (lambda: best_fit(MAP, Plane()), "to start from: choose one of them"),
        (lambda: best_fit(MAP, "sphere", distance="radial"), 'it must be "vertical" or "normal"'),
        (lambda: best_fit(MAP, "sphere", free=("tilt_x",)), "the free parameters of a sphere are tilt_x, it has x, y"),
        (lambda: best_fit(MAP, "plane", free=()), "the free parameters of a plane are none"),
        (lambda: best_fit(EMPTY, "plane"), "has 0 valid heights, a plane needs 3"),
        (lambda: best_fit(SCATTERED, "plane"), "cannot separate .* of a plane"),
        (lambda: interferogram(EMPTY), "has 0 valid heights, a sphere needs 4"),
        (lambda: interferogram(MAP, radius=0.0), "radius of a sphere"),
        (lambda: line_profile(MAP, (0, 0)), "needs either end or angle, got neither"),
        (lambda: line_profile(MAP, (0, 0), (1, 0), angle=0.0), "needs either end or angle, got both"),
        (lambda: line_profile(MAP, (0, 0), (0, 0)), "has a length of 0 mm over the map"),
        (lambda: line_profile(MAP, (0, 3), angle=0.0), "move it onto the map"),
        (lambda: line_profile(POLAR, (0, 3), angle=0.0), "move it onto the map"),
        (lambda: line_profile(MAP, (0, 0), (1, 0), step=1e-9), "more than 10000000 points, the limit: widen the step"),
        (lambda: line_profile(MAP, (0, 0), (1, 0), step=-1), "the step of a profile is -1 mm"),
        (lambda: line_profile(MAP, (0, 0), (1, np.inf)), "the end of a line is"),
        (lambda: line_profile(MAP, (0, 0), (1, 0), method="spline"), 'it must be "linear" or "cubic"'),
        (lambda: line_profile(SCATTERED, (0, 0), (1, 0)), "scattered points"),
        (lambda: LINE.without(11), "degree is 11, .* 0 to 10"),
        (lambda: slope_error(MAP, integration_length=0.01), "the limits along x are 0.1 to 2 mm"),
        (lambda: slope_error(MAP, integration_length=5), "the limits along x are 0.1 to 2 mm"),
        (lambda: slope_error(UNEVEN, integration_length=0.2), "in uneven steps"),
        (lambda: slope_error(EMPTY, integration_length=0.2), "has 0 valid heights"),
        (lambda: line_psd(MAP), 'the lines of this map run along "x" or "y"'),
        (lambda: line_psd(POLAR, along="x"), 'run along "radius"'),
        (lambda: line_psd(LINE, along="x"), "a profile has one direction"),
        (lambda: line_psd(LINE, form="sphere"), "the form of a profile is 'sphere'"),
        (lambda: line_psd(UNEVEN, along="x"), "in uneven steps"),
        (lambda: area_psd(POLAR), "polar grid, the spectrum of an area needs"),
        (lambda: area_psd(MAP, window="welch"), 'it must be "none", "hann" or "blackman"'),
        (lambda: area_psd(MAP, missing="zero"), 'it must be "rectangle" or "mask"'),
        (lambda: area_psd(MAP).band_rms_nm(3, 2), "the band is 3 to 2 /mm"),
        (lambda: bearing(HeightMap(x=X, y=X, z=0 * Z)), "bearing curve needs more than 0 nm"),
    ],
)
def test_it_is_refused_in_one_sentence(ask, words):
    with pytest.raises(InputError, match=words) as raised:
        ask()
    assert "\n" not in str(raised.value)


def test_a_map_of_holes_has_no_rectangle_but_a_mask():
    z = np.where((np.arange(21) % 4 == 0)[:, None] | (np.arange(21) % 5 == 0), np.nan, Z)
    holed = HeightMap(x=X, y=X, z=z)
    with pytest.raises(InputError, match=r'has 3 x 4 points, the least is 8 x 8: .* missing="mask"'):
        area_psd(holed)
    assert area_psd(holed, missing="mask").rms_nm > 0


def test_a_flat_map_has_a_sphere_of_infinite_radius():
    found = best_fit(HeightMap(x=X, y=X, z=np.zeros((21, 21))), "sphere")
    assert found.parameters["radius"] == np.inf
    assert found.surface.sag(0.3, 0.2) == 0
    assert found.rms_nm == 0
