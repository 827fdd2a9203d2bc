"""The edge behind a measured trace. Oracles: traces made from edges known in closed form; Taubin's algebraic circle."""

from pathlib import Path

import numpy as np
import pytest

from cases import every_second
from turnwright.metrology import fit_edge, read_edge_trace
from turnwright.tool import Tool, WavinessTable

TRACE = Path(__file__).parents[2] / "examples" / "real_part_1021" / "edge_trace.csv"


def arc_with_flanks(radius, half, reach, count, wave=None):
    """Points of an arc and its tangent flanks, evenly along u, the edge pointing up; tip at (0, 0)."""
    u = np.linspace(-reach, reach, count)
    edge = radius * np.sin(half)
    height = np.where(
        np.abs(u) <= edge,
        np.sqrt(np.maximum(radius**2 - u**2, 0)) - radius,
        radius * np.cos(half) - radius - (np.abs(u) - edge) * np.tan(half),
    )
    if wave is not None:
        sweep = np.clip(np.arctan2(u, height + radius), -half, half)
        u, height = u + wave(sweep) * np.sin(sweep), height + wave(sweep) * np.cos(sweep)
    return u, height


def taubin(x, y):
    """Radius of the circle of Taubin 1991, by the generalised eigenproblem of its algebraic distance."""
    x, y = x - x.mean(), y - y.mean()
    z = x * x + y * y
    scale = np.sqrt(4 * z.mean())
    _, _, v = np.linalg.svd(np.column_stack([(z - z.mean()) / scale, x, y]), full_matrices=False)
    a, b, c = v[2, 0] / scale, v[2, 1], v[2, 2]
    return np.sqrt((b * b + c * c) / (4 * a * a) + z.mean())


@pytest.mark.parametrize(("radius", "up"), every_second([0.05, 0.2, 1.5], [1, -1]))
def test_a_perfect_edge_comes_back(radius, up):
    u, height = arc_with_flanks(radius, np.deg2rad(55), 1.6 * radius, 1200)
    fit = fit_edge(u + 3, up * height - 7, toward_x=1, cutoff=radius / 20)
    assert fit.radius == pytest.approx(radius, rel=1e-9)
    assert np.rad2deg(fit.sweep) == pytest.approx([-55, 55], abs=1e-3)
    assert fit.centre == pytest.approx(np.array([[3, -7 - up * radius]]), abs=1e-8 * radius)
    assert np.abs(fit.tool.waviness.deviation).max() < 1e-9 * radius
    assert fit.radius_std < 1e-8 * radius


def test_noise_flanks_and_dust_do_not_pull():
    """The uncertainty is honest: over many traces the errors of the radius are as large as it says."""
    rng = np.random.default_rng(5)
    errors, stated = [], []
    for _ in range(6):
        u, height = arc_with_flanks(0.2, np.deg2rad(58), 0.45, 600)
        height = height + rng.normal(0, 2e-4, u.size)
        dust = rng.random(u.size) < 0.05
        height[dust] += rng.exponential(0.01, dust.sum())
        height[:36] -= rng.exponential(0.03, 36)  # a broken end
        fit = fit_edge(u, height, toward_x=1, cutoff=0.04)
        errors.append(fit.radius - 0.2)
        stated.append(fit.radius_std)
    assert np.median(stated) < 1e-4
    # The root mean square of 6 normal deviates lies between 0.4 and 1.7 in 98 of 100 cases; with dust, a little more.
    assert 0.4 < np.sqrt(np.mean((np.array(errors) / stated) ** 2)) < 1.8


@pytest.mark.parametrize(
    ("share", "passed"), [(1.0, 0.5), pytest.param(2.0, 16 / 17, marks=pytest.mark.proof), (0.5, 1 / 17)]
)
def test_the_bandwidth_is_the_one_stated(share, passed):
    """A wave of the cutoff keeps half its height, others 1 / (1 + (cutoff / wavelength)^4)."""
    radius, cutoff, height = 0.2, 0.010, 1e-5
    frequency = 2 * np.pi * radius / (share * cutoff)

    def wave(sweep):
        return height * np.cos(frequency * sweep)

    u, trace = arc_with_flanks(radius, np.deg2rad(58), 0.3, 6000, wave)
    table = fit_edge(u, trace, toward_x=1, cutoff=cutoff).tool.waviness
    inner = np.abs(table.sweep) < 0.8
    basis = np.column_stack([np.cos(frequency * table.sweep), np.sin(frequency * table.sweep), np.ones(inner.size)])
    found = np.linalg.lstsq(basis[inner], table.deviation[inner], rcond=None)[0]
    # Averaging over an eighth of the cutoff takes another sinc of it off.
    assert found[0] / height == pytest.approx(passed * np.sinc(1 / (8 * share)), abs=0.02)


def test_the_waviness_of_a_tool_comes_back_either_way_round():
    sweep = np.linspace(-1, 1, 41)
    wavy = WavinessTable(sweep=sweep, deviation=3e-4 * np.sin(9 * sweep + 0.4))
    tool = Tool(nose_radius=0.5, included=np.deg2rad(110), waviness=wavy)
    u, _, e = tool.edge(np.linspace(-1.3, 1.3, 2001))
    for way in (1, -1):
        fit = fit_edge(way * u, -e, toward_x=way, cutoff=0.02, nose_radius=0.5)
        assert fit.tool.nose_radius == 0.5
        # The same edge, whatever share of it is called radius, centre and waviness: compare its points.
        found = np.column_stack(fit.tool.edge(np.linspace(-0.8, 0.8, 400)))[:, [0, 2]]
        shift = (fit.centre[0] - [0, -0.5]) * [way, 1]  # the circle that fits is not about the nominal centre
        found += np.array([shift[0], -shift[1] - (fit.radius - 0.5)])
        at = np.arctan2(found[:, 0], 0.5 - found[:, 1])
        off = np.hypot(found[:, 0], 0.5 - found[:, 1]) - 0.5 - tool.deviation(at)
        assert np.abs(off).max() < 2e-6


def test_strokes_that_miss_each_other_are_put_together():
    """Two strokes of one edge, the second put 4 um off and 5 um lower, as on measured traces."""
    u, height = arc_with_flanks(0.2, np.deg2rad(60), 0.5, 3000)
    left, right = u < 0.05, u > 0.02
    along = np.concatenate([u[left], u[right] + 0.004])
    across = np.concatenate([height[left], height[right] - 0.005])
    fit = fit_edge(along, across, toward_x=1, cutoff=0.01)
    assert fit.radius == pytest.approx(0.2, abs=1e-8)
    assert fit.centre == pytest.approx(np.array([[0, -0.2], [0.004, -0.205]]), abs=1e-7)


def test_tilt_levels_the_flanks():
    u, height = arc_with_flanks(0.2, np.deg2rad(60), 0.5, 3000)
    turn = np.deg2rad(7)
    x, y = u * np.cos(turn) + height * np.sin(turn), height * np.cos(turn) - u * np.sin(turn)
    first = fit_edge(x, y, toward_x=1, cutoff=0.01)
    assert np.rad2deg(first.tilt) == pytest.approx(7, abs=1e-3)
    assert np.rad2deg(first.tool.included) == pytest.approx(2 * 53, abs=2e-3)
    levelled = fit_edge(x, y, toward_x=1, cutoff=0.01, tilt=-first.tilt)
    assert np.rad2deg(levelled.tool.included) == pytest.approx(120, abs=2e-3)
    assert levelled.tilt == pytest.approx(0, abs=1e-12)


def test_a_measured_edge_agrees_with_the_algebraic_circle():
    """The diamond of part 1021, its first stroke alone, so that one circle is right; the same points for both."""
    u, height = read_edge_trace(TRACE)
    fit = fit_edge(u[:1838], height[:1838], toward_x=1, cutoff=0.01)
    assert fit.radius == pytest.approx(taubin(u[:1838][fit.nose], height[:1838][fit.nose]), abs=0.5 * fit.radius_std)
    assert fit.radius_std < 2e-3


@pytest.mark.parametrize("together", [pytest.param(1, marks=pytest.mark.proof), 5])
def test_the_uncertainty_of_the_waviness_covers_its_error(together):
    """Oracle: a perfect nose under white noise, and under noise that five neighbouring points share."""
    rng, tool = np.random.default_rng(0), Tool(nose_radius=0.2, included=np.deg2rad(110))
    u, _, e = tool.edge(np.deg2rad(np.linspace(-70, 70, 1001)))
    off = []
    for _ in range(12):
        noise = np.convolve(rng.normal(size=u.size + together - 1), np.full(together, together**-0.5), "valid")
        fit = fit_edge(u, 1e-4 * noise - e, toward_x=1, cutoff=0.02)
        off.append(fit.tool.waviness.deviation / fit.waviness_std)
    assert 0.9 < np.std(np.concatenate(off)) < 1.2
    # Some 200 independent values: 95 % of them lie inside within 1.5 %, three times that is let pass.
    assert np.mean(np.abs(np.concatenate(off)) < 1.96) > 0.905


def test_one_of_several_profiles_and_plain_columns_are_read(tmp_path):
    rows = [(0.001 * k, 0.1 * profile) for profile in (1, 2, 3) for k in range(4)]
    several = tmp_path / "several.csv"
    several.write_text(
        "Number of data,4,3\nX,Y,Z\n" + "\n".join(f"{x:.3f},{y:.3f},{y + 1:.3f}" for x, y in rows), encoding="utf-8"
    )
    u, height = read_edge_trace(several, profile=2)
    np.testing.assert_allclose(u, [0, 0.001, 0.002, 0.003])
    np.testing.assert_allclose(height, 0.2)
    with pytest.raises(ValueError, match="holds 3 profiles"):
        read_edge_trace(several)
    with pytest.raises(ValueError, match="no profile 4"):
        read_edge_trace(several, profile=4)
    plain = tmp_path / "plain.txt"
    plain.write_text("0.1 2.5 \n0.2 2.6 \n", encoding="utf-8")
    np.testing.assert_allclose(read_edge_trace(plain), [[0.1, 0.2], [2.5, 2.6]])
