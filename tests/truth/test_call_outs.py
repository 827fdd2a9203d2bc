"""Call-outs of a drawing: printed examples, arithmetic of fringe spacings, closed forms of waves and Zernike terms."""

import numpy as np
import pytest

import turnwright as tw
from turnwright.errors import InputError
from turnwright.job.verdict import _along_normal
from turnwright.metrology import evaluate_call_out, form_components, read_call_out, require_consistent

LAMBDA = 546.07
RADIUS = 2.0
DISC = tw.Outline(disc=RADIUS)

MEAN_SQUARES = {
    4: 1 / 3,
    5: 1 / 6,
    6: 1 / 6,
    7: 1 / 8,
    8: 1 / 8,
    9: 1 / 5,
    12: 1 / 10,
    16: 1 / 7,
    25: 1 / 9,
    37: 1 / 13,
}
"""Of fringe terms of value 1 at the rim: 1 / (n + 1), half of it with an azimuth."""

ROUND = (9, 16, 25, 37)


def limits_of(text):
    call_out = read_call_out(text)
    return {symbol: value * call_out.scale for symbol, value in call_out.limits}


# Printed by Layertec, "Surface form tolerances", with their meaning; and ISO 10110-5 by hand.
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("3/ – (1); RMS a < 0.1; λ = 546 nm", {"B": 273, "RMSa": 27.3}),
        ("3/ 2(1/0.5); λ = 632.8 nm", {"A": 632.8, "B": 316.4, "C": 158.2}),
        ("3/ –; RMSt < 100 nm; RMSi < 30 nm; λ = 546 nm", {"RMSt": 100, "RMSi": 30}),
        (
            "3/ 0,5(0,2/0,1) RMSi ≤ 0,05; lambda = 546,07 nm",
            {"A": 0.25 * LAMBDA, "B": 0.1 * LAMBDA, "C": 0.05 * LAMBDA, "RMSi": 0.025 * LAMBDA},
        ),
        ("3/ 100(50/25) nm RMSt < 40 nm", {"A": 100, "B": 50, "C": 25, "RMSt": 40}),
        ("3/ 0.1 µm (50 nm)", {"A": 100, "B": 50}),
        ("Ra 0.02", {"Ra": 20}),
        ("U 0.0025-0.8 / Rz 0,1", {"Rz": 100}),
        ("PSD 5e-8 µm³/2; 0.01/1", {"PSD": 50}),  # 1 µm³ is 1e3 nm² mm, and (1/µm)² is 1e6 (1/mm)²
        ("slope < 0.5 mrad; 1 mm; 0.1 mm", {"slope": 0.5}),
        ("rms slope < 20 urad; 1", {"rms slope": 0.02}),
    ],
)
def test_a_call_out_has_the_limits_it_prints(text, expected):
    found = limits_of(text)
    assert found.keys() == expected.keys()
    for symbol, value in expected.items():
        assert found[symbol] == pytest.approx(value, rel=1e-12), symbol


def test_default_nesting_indices_follow_the_limit():
    """ISO 21920-3: Ra up to 0.02, 0.1, 2, 10 µm and Rz up to 0.16, 0.8, 16, 80 µm have 0.08, 0.25, 0.8, 2.5, 8 mm."""
    for symbol, tops in (("Ra", (0.02, 0.1, 2, 10, 20)), ("Rz", (0.16, 0.8, 16, 80, 160))):
        for top, (short, long) in zip(
            tops, ((0.0025, 0.08), (0.0025, 0.25), (0.0025, 0.8), (0.008, 2.5), (0.025, 8)), strict=True
        ):
            assert read_call_out(f"{symbol} {top}").band == (short, long)


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["3/ 0.5(0.2); λ = 546"], "has no unit: write λ = 546 nm"),
        (["3/ 0.5(0.2)"], "without their wavelength"),
        (["3/ 0.5(0.2); λ = 546 µm"], "check its unit"),
        (["3/ 1(0.2/0.3); λ = 633 nm"], "C never exceeds B"),
        (["3/ 1(0.2) RMSi < 0.3; λ = 633 nm"], "RMSi never exceeds B"),
        (["3/ 1(0.2); λ = 633 nm", "3/ 2; λ = 633 nm"], "limit A to 316.5 nm and A to 633 nm"),
        (["Ra 0.01; 0.08", "Ra 0.02; 0.08"], "state one limit"),
        (["0.0025-0.08 / Ra 0.02", "0.0025-0.08 / Rz 0.01"], "Ra never exceeds Rz"),
        (["3/ 0.5(0.2) all ø 20; λ = 633 nm"], "diameter of test areas"),
        (["3/ 0.5(0.2) RMSx < 1; λ = 633 nm"], "'RMSx < 1'"),
        (["3/ –"], "0 limits"),
        (["3/ 0(1); λ = 546 nm"], "above 0"),
        (["Sq 2; 0.01/1"], "write Sq 2 nm"),
        (["PSD 0.3/2; 0.01/1"], "no unit"),
        (["slope 0.5; 1"], "mrad"),
        (["slope < 0.5 mrad; 0.1; 1"], "shorter"),
        (["Rq 0.01"], "0.0025-0.8 / Rq 0.01"),
        (["3/ 1(0.5) λ = 546 nm; λ = 1064 nm"], "each once"),
        (["3/ 500(100/50 nm); λ = 546 nm"], "some of A, B and C"),
        (["Ra 0.02", "0.0025-0.08 / Ra 0.05"], "state one limit"),
        (["3/ 0.5(0.2) all ∅ 20; λ = 633 nm"], "diameter of test areas"),
        (["-0.8 / Ra 0.02; 0.8"], "twice"),
        (["Sq 2 nm; 1/0.01"], "shorter"),
        (["Sq 2 nm; 0/1"], "length of 0 mm"),
        (["Ra " + "9" * 300], "the limit is 200"),
        (["PSD 1 nm² mm/400; 0.1/1"], "cannot be read"),
        (["4/ 3'"], "cannot be read"),
    ],
)
def test_a_wrong_call_out_is_refused_in_a_sentence(texts, words):
    with pytest.raises(InputError) as refusal:
        require_consistent([read_call_out(text) for text in texts])
    assert words in str(refusal.value)
    assert len(str(refusal.value)) <= 400


def grids():
    x = np.linspace(-RADIUS, RADIUS, 121)
    away = np.hypot(x, x[:, None])
    yield tw.HeightMap(x=x, y=x, z=np.where(away <= RADIUS, 0.0, np.nan))
    # With the radii and azimuths of the extremes of the terms below.
    radius = RADIUS * np.sqrt(np.linspace(0, 1, 61))
    angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    yield tw.HeightMap(radius=radius, angle=angle, z=np.zeros((72, 61)))
    random = np.random.default_rng(5)
    at = RADIUS * np.sqrt(random.uniform(0, 1, 9000)) * np.exp(2j * np.pi * random.uniform(0, 1, 9000))
    rim = RADIUS * np.exp(2j * np.pi * np.arange(180) / 180) * (1 - 1e-12)
    at = np.concatenate([at, rim])
    yield tw.HeightMap(x=at.real, y=at.imag, z=np.zeros(at.size))


def made(grid, terms):
    x, y = grid.points()
    z = tw.Zernike(terms=terms, radius=RADIUS, indexing="fringe").sag(x, y)
    return tw.HeightMap(
        x=grid.x, y=grid.y, radius=grid.radius, angle=grid.angle, z=np.where(np.isnan(grid.z), np.nan, z)
    )


@pytest.mark.parametrize("grid", list(grids()), ids=["rectangular", "polar", "scattered"])
def test_zernike_maps_are_decomposed_exactly(grid):
    """Oracles: A is twice the coefficient of 2 rho^2 - 1; B, C by the terms at the points; rms by orthogonality."""
    random = np.random.default_rng(7)
    for _ in range(3):
        terms = {j: float(random.normal(0, 5e-5)) for j in (1, 2, 3, *MEAN_SQUARES)}
        found = form_components(made(grid, terms), DISC)
        irregular = {j: c for j, c in terms.items() if j > 4}
        symmetric = {j: c for j, c in terms.items() if j in ROUND}
        expected = {
            "A": 2 * abs(terms[4]),
            "B": np.ptp(one := made(grid, irregular).z[~np.isnan(grid.z)]),
            "C": np.ptp(made(grid, symmetric).z[~np.isnan(grid.z)]),
            "RMSt": np.sqrt(sum(c * c * MEAN_SQUARES[j] for j, c in terms.items() if j >= 4)),
            "RMSi": np.sqrt(sum(c * c * MEAN_SQUARES[j] for j, c in irregular.items())),
            "RMSa": np.sqrt(sum(c * c * MEAN_SQUARES[j] for j, c in irregular.items() if j not in ROUND)),
        }
        assert one.size > 4000
        for symbol, value in expected.items():
            assert found.values[symbol] == pytest.approx(value, rel=1e-9), symbol


def test_the_arithmetic_of_the_how_to():
    """Z4 40, Z5 20, Z9 10 nm: where cos 2t = -1, B spans 30 nm to 60 r^4 - 80 r^2 + 10 at r^2 = 2/3."""
    _, polar, _ = grids()
    values = form_components(made(polar, {4: 40e-6, 5: 20e-6, 9: 10e-6}), DISC).values
    expected = {
        "A": 80, "B": 30 + 50 / 3, "C": 15,
        "RMSt": np.sqrt(620), "RMSi": np.sqrt(260 / 3), "RMSa": np.sqrt(200 / 3),
    }  # fmt: skip
    for symbol, nm in expected.items():
        assert values[symbol] * 1e6 == pytest.approx(nm, rel=1e-9), symbol


def test_a_concentric_sphere_has_a_constant_error_along_the_normal():
    """A sphere of 3 mm with its centre kept and its radius 10 nm smaller, on a steep part: 45 degrees at the rim."""
    part = tw.Part(surface=tw.Sphere(radius=3.0), radius=3 / np.sqrt(2))
    x = np.linspace(-2, 2, 41)
    away = np.hypot(x, x[:, None])
    away = np.where(away <= part.reach, away, np.nan)
    made = 3 - np.sqrt((3 - 1e-5) ** 2 - away**2)  # a bowl; material is added
    error = _along_normal(part, part.form_error(tw.HeightMap(x=x, y=x, z=made)))
    assert np.nanmax(np.abs(error.z - 1e-5)) < 1e-9 * 3


def test_a_map_of_another_aperture_is_fitted_over_it():
    """Oracle: NumPy's least squares of piston, tilt and sphere over the points of an annulus."""
    x = np.linspace(-RADIUS, RADIUS, 141)
    across, up = np.meshgrid(x, x)
    away = np.hypot(across, up)
    z = 1e-5 * across**2 + 2e-5 * up**2 + 1e-5 * across * away
    ring = (away >= 0.8) & (away <= RADIUS)
    found = form_components(tw.HeightMap(x=x, y=x, z=np.where(ring, z, np.nan)), tw.Outline(annulus=(RADIUS, 0.8)))
    rows = np.stack([np.ones(ring.sum()), across[ring], up[ring], away[ring] ** 2], axis=1)
    parts = np.linalg.lstsq(rows, z[ring], rcond=None)[0]
    residual = z[ring] - rows @ parts
    assert found.power_pv == pytest.approx(abs(parts[3]) * np.ptp(away[ring] ** 2), rel=1e-9)
    assert found.irregularity_pv == pytest.approx(np.ptp(residual), rel=1e-9)
    assert found.rms_irregularity == pytest.approx(np.std(residual), rel=1e-9)
    level = z[ring] - rows[:, :3] @ np.linalg.lstsq(rows[:, :3], z[ring], rcond=None)[0]
    assert found.rms_total == pytest.approx(np.std(level), rel=1e-9)
    assert found.rms_asymmetry < found.rms_irregularity


def test_a_map_smaller_than_the_clear_aperture_is_refused():
    rectangular, polar, scattered = grids()
    for one in (rectangular, polar, scattered):
        with pytest.raises(
            InputError, match=r"smaller than the clear aperture: at its border at x = .* 0\.\d+ mm away"
        ):
            form_components(one, tw.Outline(disc=1.15 * RADIUS))
    x, _ = rectangular.points()
    half = tw.HeightMap(x=rectangular.x, y=rectangular.y, z=np.where(x < 1.5, rectangular.z, np.nan))
    with pytest.raises(InputError, match="smaller than the clear aperture"):
        form_components(half, DISC)


WAVE, AMPLITUDE, LENGTH = 0.02, 1e-5, 1.0
"""A sine of 10 nm and 50 waves per mm. [mm]"""


def sine(along="x"):
    x = np.arange(1000) * (LENGTH / 1000)
    z = np.tile(AMPLITUDE * np.sin(2 * np.pi * x / WAVE), (1000, 1))
    return tw.HeightMap(x=x, y=x, z=z if along == "x" else z.T)


def test_band_rms_and_density_of_a_sine():
    """Hann window, whole waves: the mean square is a^2/2, and the density of the middle bin a^2 L / 3."""
    square = sine()
    assert evaluate_call_out(read_call_out("Sq 8 nm; 0.01/0.1"), square) == pytest.approx(AMPLITUDE / np.sqrt(2))
    assert evaluate_call_out(read_call_out("Rq 8 nm; 0.01/0.1"), square) == pytest.approx(AMPLITUDE / np.sqrt(2))
    assert evaluate_call_out(read_call_out("Sq 8 nm; 0.03/0.1"), square) < 1e-4 * AMPLITUDE
    density = evaluate_call_out(read_call_out("PSD 1e5 nm² mm/2; 0.01/0.1"), square)
    assert density * 1e12 == pytest.approx(10**2 * LENGTH / 3 / WAVE**2)  # 83 333 nm² mm at 1/mm
    same = read_call_out("PSD 1e-4 µm³/2; 0.01/0.1").limits[0].value
    assert same == pytest.approx(read_call_out("PSD 1e5 nm² mm/2; 0.01/0.1").limits[0].value)


@pytest.mark.parametrize("along", ["x", "y"])
def test_profile_parameters_of_a_sine(along):
    """Ra the mean of the sampled wave, Rq a/sqrt(2), Rz 2a, after Gaussian filters that transmit 2^-(cutoff/wave)^2."""
    passed = 2 ** -((0.005 / WAVE) ** 2) * (1 - 2 ** -((0.08 / WAVE) ** 2))
    for symbol, share in (("Ra", np.abs(np.sin(np.pi * np.arange(20) / 10)).mean()), ("Rq", 1 / np.sqrt(2)), ("Rz", 2)):
        text = f"0.005-0.08 / {symbol} 0.01"
        assert evaluate_call_out(read_call_out(text), sine(along)) == pytest.approx(
            share * AMPLITUDE * passed, rel=5e-3
        )


def test_slopes_of_a_wave_over_a_length():
    """Largest slope 2a sin(pi L/p)/L at the phase of the crossing, rms that over sqrt(2)."""
    x = np.arange(450) * 0.01  # the slopes start in two whole waves
    wave = tw.HeightMap(x=x, y=x, z=np.tile(1e-3 * np.sin(2 * np.pi * x / 2), (450, 1)))
    expected = 2e-3 * np.sin(np.pi * 0.5 / 2) / 0.5
    assert evaluate_call_out(read_call_out("slope < 5 mrad; 0.5; 0.1"), wave) == pytest.approx(expected, rel=1e-3)
    rms = evaluate_call_out(read_call_out("rms slope < 5 mrad; 0.5; 0.1"), wave)
    assert rms == pytest.approx(expected / np.sqrt(2), rel=1e-3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Sq 8 nm; 0.001/0.1", "resolves 2 um to"),
        ("PSD 50 nm² mm/2; 0.01/2", "resolves 2 um to"),
        ("slope < 5 mrad; 0.05; 0.0005", "1 um apart"),
        ("Ra 0.02", "steps of the grid"),
        ("0.005-0.25 / Ra 0.02", "5 sections of 0.25 mm need more"),
    ],
)
def test_a_map_that_cannot_tell_is_refused(text, words):
    with pytest.raises(InputError, match=words):
        evaluate_call_out(read_call_out(text), sine())
