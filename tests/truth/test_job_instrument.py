"""A map seen through the instrument of its job. Oracles: sinc of a pixel, the sine's own closed form, brute means."""

import tomllib

import numpy as np
import pytest

import turnwright as tw
from turnwright.job.pass_plan import cut_heights, motion_of


def job_of(surface, feed=25, **measurement):
    return tw.Job.read(
        {
            "part": {"name": "part", "radius": "2 mm", "surface": surface},
            "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
            "machine": {"name": "generic"},
            "strategy": {"kind": "slow tool servo", "feed": f"{feed} um/rev", "points_per_rev": 360},
            "measurement": {"free": ["z"], **measurement},
        }
    )


def test_cusps_agree_only_through_the_instrument():
    """Resolution of 10 um at a feed of 25 um. The instrument of the oracle convolves by a dense sum of its own."""
    sphere = {"family": "sphere", "radius": "20 mm"}
    instrument = {"resolution": "10 um", "pixel": "2 um"}
    job = job_of(sphere, instrument=instrument)
    fine, ratio, side = 1e-3, 2, 400
    axis = 0.3 + (np.arange(side) + 0.5) * 2e-3
    wide = 0.3 - 0.1 + np.arange(int((side * 2e-3 + 0.2) / fine)) * fine
    x, y = np.meshgrid(wide, wide - 0.6)
    plain = job_of(sphere)
    error = cut_heights(motion_of(plain), plain, x.ravel(), y.ravel()).reshape(x.shape) - plain.part.surface.sag(x, y)
    seen = blurred(error, fine, 0.010, 2e-3)
    first = round((axis[0] - wide[0]) / fine)
    z = seen[first : first + ratio * side : ratio, first : first + ratio * side : ratio]
    u, v = np.meshgrid(axis, axis - 0.6)
    assert wide[first] == pytest.approx(axis[0], abs=1e-9)
    z = z + plain.part.surface.sag(u, v)
    measured = tw.measure(job, tw.HeightMap(x=axis, y=axis - 0.6, z=z))
    texture = measured.texture
    assert texture.seen_nm == pytest.approx(texture.measured_nm, rel=0.02)
    assert texture.predicted_nm > 1.15 * texture.measured_nm


def blurred(z, step, resolution, pixel):
    """Return heights through the incoherent transfer of a round pupil and a pixel, as a product of spectra."""
    fy, fx = np.meshgrid(np.fft.fftfreq(z.shape[0], step), np.fft.fftfreq(z.shape[1], step), indexing="ij")
    q = np.minimum(np.hypot(fx, fy) * resolution, 1.0)
    passed = 2 / np.pi * (np.arccos(q) - q * np.sqrt(1 - q * q))
    return np.fft.ifft2(np.fft.fft2(z) * passed * np.sinc(fx * pixel) * np.sinc(fy * pixel)).real


def test_instrument_pixel_does_not_lower_the_form():
    """A pixel of 0.1 mm passes sinc(p / L) of a sine of 1.5 mm: 7 nm of 1 um, which is no error of the part."""
    surface = {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["1.5 mm", "1.5 mm"]}
    pixel, axis = 0.1, np.linspace(-2, 2, 41)
    x, y = np.meshgrid(axis, axis)
    plain = job_of(surface, 100)
    passed = np.sinc(pixel / 1.5)
    z = plain.part.surface.sag(x, y) * passed
    z[np.hypot(x, y) > 1.95] = np.nan
    heights = tw.HeightMap(x=axis, y=axis, z=z)
    without = tw.measure(plain, heights)
    through = tw.measure(job_of(surface, 100, instrument={"pixel": "0.1 mm"}), heights)
    assert without.form_rms_nm == pytest.approx((1 - passed) * 1e3 * np.std(z[np.isfinite(z)]) / passed * 1e3, rel=0.05)
    assert through.form_rms_nm < 0.02 * without.form_rms_nm
    assert through.instrument_effect_nm == pytest.approx(without.form_rms_nm, rel=0.05)
    assert without.instrument_effect_nm is None
    assert without.texture is None


def test_optics_do_not_bend_the_form():
    """A sphere of 40 fringes: light from far away averages out, so its image is the sphere."""
    sphere = {"family": "sphere", "radius": "20 mm"}
    axis = np.linspace(-0.4, 0.4, 101)
    x, y = np.meshgrid(axis, axis)
    job = job_of(sphere, instrument={"resolution": "5 um"})
    measured = tw.measure(job, tw.HeightMap(x=axis, y=axis, z=job.part.surface.sag(x, y)))
    assert measured.instrument_effect_nm == 0
    assert measured.form_rms_nm < 1e-3


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ("zygo-nexview-10", "zygo-nexview-10x"),
        ({}, "has no values"),
        ("none.toml", "none.toml"),
        ({"name": "fizeau-50mm", "file": "x.toml"}, "x.toml"),
        ({"pixel": "0 mm"}, "pixel"),
        ({"pixels": "1 um"}, "pixels"),
        ({"resolution": "1 um", "numerical_aperture": 0.3}, "aperture"),
    ],
)
def test_a_wrong_instrument_of_a_job_names_what_is_allowed(stated, words):
    with pytest.raises(tw.JobError, match="instrument") as caught:
        job_of({"family": "plane", "slope": [0.0, 0.0]}, instrument=stated)
    assert words in str(caught.value)
    assert len(str(caught.value)) < 400


def test_an_instrument_is_a_name_a_file_or_a_table(tmp_path):
    flat = {"family": "plane", "slope": [0.0, 0.0]}
    file = tmp_path / "own.toml"
    file.write_text('pixel = "3 um"\nnoise = "2 nm"\n')
    by_name = job_of(flat, instrument="fizeau-50mm").measurement.instrument
    assert by_name == tw.Instrument.load("fizeau-50mm")
    assert job_of(flat, instrument=str(file)).measurement.instrument == tw.Instrument.load(file)
    quiet = job_of(flat, instrument={"file": str(file), "noise": "1 nm"})
    assert quiet.measurement.instrument.noise == pytest.approx(1e-6)
    assert quiet.measurement.instrument.pixel == pytest.approx(3e-3)
    assert tw.Job.read(tomllib.loads(quiet.to_toml())) == quiet
