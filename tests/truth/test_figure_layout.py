"""Texts are where matplotlib puts them; none is clipped or in other axes. Oracle: its own ticks and boxes."""

import io
import re
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_svg import FigureCanvasSVG

from cases import every_second
from turnwright.heightmap import HeightMap
from turnwright.outline import Outline
from turnwright.report import figures, printing, study_figures

EXTENTS = [(0.0, 3e7), (-2e6, 1e-9)]
"""Middle and half-range of values: large, and tiny with an offset that the axis states."""


def over(middle, half, count=301):
    return middle + half * np.sin(np.linspace(0, 7, count))


def grid(middle, half, size=1.0):
    x = np.linspace(-size, size, 31)
    return HeightMap(z=over(middle, half, 961).reshape(31, 31) * 1e-6, x=x, y=x)


def motion(middle, half):
    values = over(middle, half)
    axes = {"X": over(0, 25), "C": np.linspace(0, 6.28, 301), "Z": values * 1e-3, "W": values}
    return SimpleNamespace(time=np.linspace(0, 1 + half, 301), axes=axes, sense=1)


def tried(middle, half, count):
    limits = SimpleNamespace(cycle_time_s=60.0 * (middle + half))
    breakdown = SimpleNamespace(pv_nm=half, cusp_nm=half, chord_nm=half / 3, tracking_nm=abs(middle))
    return [SimpleNamespace(name="name", limits=limits, breakdown=breakdown)] * count


def of_study(middle, half, text):
    values = over(middle, half, 9)
    field = np.array([f"a rather long name {k}" for k in range(3)]) if text else np.array([1.0, 2.0, 4.0]) * half
    names = {"values": np.repeat(field, 3), "different": field, "job_value": field[1]}
    first = SimpleNamespace(name="first", heading="first [mm]", unit="mm", **names)
    second = SimpleNamespace(
        name="second", heading="second [µm]", unit="µm", different=np.array([1.0, 2.0, 3.0]) + middle
    )
    second.values, second.job_value = np.tile(second.different, 3), None
    column = SimpleNamespace(heading="a measure of the part [nm]", values=values, different=values)
    ok = np.ones((3, 3), dtype=bool)
    return SimpleNamespace(
        fields=[first, second], column=lambda _: column, ok=ok.ravel(),
        grid=lambda *_, **__: SimpleNamespace(rows=second.different, values=values.reshape(3, 3), ok=ok),
    )  # fmt: skip


def group(name):
    interval = SimpleNamespace(value=0.4, low=0.2, high=0.7)
    return SimpleNamespace(group=name, first=interval, total=interval, neighbour_index=0.4)


DISC = Outline(disc=1.0)
TURN = np.linspace(0, 6.2, 40)
DRAWN = {
    "profile": lambda m, h: figures.profile(grid(m, h), 0.01),
    "error map": lambda m, h: figures.error_map(grid(m, h, 1e-4 if h < 1 else 1e3)),
    "places": lambda m, h: figures.places_map(grid(m, h), DISC, "title of the map"),
    "over radius": lambda m, h: figures.over_radius(grid(m, h), 1.2),
    "rings": lambda m, h: figures.rings(
        HeightMap(z=over(m, h, 1200).reshape(40, 30) * 1e-6, radius=np.linspace(0, abs(m) + h, 30), angle=TURN)
    ),
    "contact": lambda m, h: figures.contact(
        SimpleNamespace(air_height=None, sweep=over(m, h), contact_x=over(m, h), contact_y=over(0, h))
    ),
    "axes over time": lambda m, h: figures.axes_over_time(motion(m, h)),
    "z over turns": lambda m, h: figures.z_over_turns([motion(m, h)] * 3),
    "density": lambda m, h: figures.density(
        SimpleNamespace(frequency=np.geomspace(1, 2 + h, 50), density=np.geomspace(h + abs(m), 1e-9, 50), unit="nm³")
    ),
    "minutes and errors": lambda m, h: figures.minutes_and_errors(tried(m, h, 3) + tried(h, 2 * h, 2)),
    "breakdown": lambda m, h: figures.breakdown_of(tried(m, h, 12)),
    "tornado": lambda m, h: study_figures.tornado([group(f"concave sphere: a long name {m + h:g}")] * 12, "title"),
    "histogram": lambda m, h: study_figures.histogram({"planned": over(m, h), "corrected": over(m, h / 2)}, "PV", None),
    "line": lambda m, h: study_figures.draw_line(of_study(m, h, text=False), "pv"),
    "line of texts": lambda m, h: study_figures.draw_line(of_study(m, h, text=True), "pv"),
    "map": lambda m, h: study_figures.draw_map(of_study(m, h, text=False), "pv"),
    "map of texts": lambda m, h: study_figures.draw_map(of_study(m, h, text=True), "pv"),
    "profiles": lambda m, h: study_figures.profiles_of(of_study(m, h, text=False), "pv"),
    "scatter": lambda m, h: study_figures.scatter(of_study(m, h, text=False), ["pv", "rms"]),
}  # fmt: skip


PRINT = figures._print_svg


def texts_of(svg):
    """Return each text with its place, sorted; formulas have no place."""
    found = re.findall(r'<text [^>]*? x="([-.\d]+)" y="([-.\d]+)"[^>]*>([^<]*)', svg)
    return sorted((text, round(float(x)), round(float(y)), float(x), float(y)) for x, y, text in found)


@pytest.fixture
def printed(monkeypatch):
    """Figures with the axes of matplotlib, in the layout in which they were printed, and what was printed."""
    seen = []

    def keep(canvas):
        svg = PRINT(canvas)
        figure = canvas.figure
        figure.set_layout_engine("none")
        for axes in figure.axes:
            axes.xaxis.set_visible(True)
            axes.yaxis.set_visible(True)
            for one in [one for one in axes.get_children() if isinstance(one, printing._Scale)]:
                one.remove()
        seen.append((figure, svg))
        return svg

    monkeypatch.setattr(figures, "_print_svg", keep)
    return seen


@pytest.mark.parametrize(("name", "extent"), every_second(DRAWN, EXTENTS))
def test_texts_stand_where_matplotlib_puts_them_and_in_no_others_place(name, extent, printed):
    DRAWN[name](*extent)
    figure, svg = printed[0]
    text = io.StringIO()
    with figures._styled(figures.STYLE):
        FigureCanvasSVG(figure).print_svg(text)
    ours, theirs = texts_of(svg), texts_of(text.getvalue())
    assert ours
    assert [one[0] for one in ours] == [one[0] for one in theirs]
    places = np.array([one[3:] for one in ours]), np.array([one[3:] for one in theirs])
    np.testing.assert_allclose(*places, atol=1.2)
    require_texts_in_place(figure)


def require_texts_in_place(figure):
    """Raise if a text is clipped or in other axes."""
    figure.dpi = 300  # lengths of text are whole pixels
    renderer = figure._get_renderer()
    boxes = []
    for axes in figure.axes:
        texts = [axes.xaxis.get_tightbbox(renderer, for_layout_only=True)]
        texts.append(axes.yaxis.get_tightbbox(renderer, for_layout_only=True))
        texts += [axes.title.get_window_extent(renderer)] if axes.get_title() else []
        texts += [axes.get_legend().get_window_extent(renderer)] if axes.get_legend() else []
        boxes += [(axes, box) for box in texts if box is not None]
    for axes, box in boxes:
        assert (figure.bbox.min - 4 <= box.min).all(), box
        assert (box.max <= figure.bbox.max + 4).all(), box
        assert not any(other.bbox.padded(-4).overlaps(box) for other in figure.axes if other is not axes), box
