"""What the drawings are made of: lines, arrows, dimensions, labels and hatching, written as plain SVG.

A `Sheet` is in pixels, y downward. A `View` maps millimetres, z upward, onto it. Colours are those of docs/design.md;
they follow the reader's scheme, and paper is light. Every sheet has a ground of its own, to be read on any page.
"""

import re
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape

import numpy as np

PAPER = {"face": "#ffffff", "line": "#cfd6db", "ink": "#14191d", "quiet": "#4f5b64", "accent": "#0b5c7a",
         "bad": "#a8321b", "warn": "#7a5200", "good": "#0d6b58"}  # fmt: skip
NIGHT = {"face": "#171c20", "line": "#2f383f", "ink": "#e5eaed", "quiet": "#9daab4", "accent": "#6cc4e4",
         "bad": "#ff957f", "warn": "#e6b450", "good": "#63c7ae"}  # fmt: skip

PENS = {
    "outline": ("ink", 1.6, ""),  # a surface, a part
    "thin": ("quiet", 1.0, ""),  # dimensions, leaders
    "faint": ("line", 1.2, ""),
    "dashed": ("quiet", 1.2, "5 4"),  # nominal, hidden
    "centre": ("quiet", 1.0, "14 3 2 3"),  # axes
    "tool": ("accent", 2.0, ""),
    "tooldashed": ("accent", 1.4, "6 4"),
    "toolthin": ("accent", 1.1, ""),
    "wrong": ("bad", 2.0, ""),
    "wrongthin": ("bad", 1.2, ""),
    "wrongdashed": ("bad", 1.6, "6 3"),
    "chipline": ("warn", 1.6, ""),
}
"""Pens: colour, width in px, dashes."""

FILLS = {"diamond": ("accent", 0.13), "chip": ("warn", 0.3), "broken": ("bad", 0.45), "blank": ("quiet", 0.1)}
"""Fills: colour, opacity."""

INKS = ("ink", "quiet", "accent", "bad", "warn", "good")
FONT = "system-ui, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, 'DejaVu Sans', sans-serif"
LEAST, SMALL, NORMAL, HEAD = 11, 12, 13, 14
"""Sizes of text: of subscripts, notes, labels and titles. [px]"""
MARKUP = re.compile(r"\*([^*]+)\*|_\{([^}]*)\}|\^\{([^}]*)\}|([^*_^]+|.)")


def _colours(scheme):
    rules = [f".ground{{fill:{scheme['face']};stroke:{scheme['line']}}}", f"text{{stroke:{scheme['face']}}}"]
    rules += [f".{name}{{stroke:{scheme[colour]}}}" for name, (colour, _, _) in PENS.items()]
    rules += [f".{name}{{fill:{scheme[colour]}}}" for name, (colour, _) in FILLS.items()]
    rules += [f".{name}{{fill:{scheme[name]}}}" for name in INKS]
    return rules


def style():
    """Return the style sheet of every drawing."""
    shapes = [
        f"text{{font-family:{FONT};font-size:{NORMAL}px;paint-order:stroke;stroke-width:3.5px;stroke-linejoin:round}}",
        f".small{{font-size:{SMALL}px}}",
        f".head{{font-size:{HEAD}px;font-weight:600}}",
        "path,line,rect{fill:none;stroke-linejoin:round;stroke-linecap:butt}",
    ]
    for name, (_, width, dashes) in PENS.items():
        shapes.append(f".{name}{{stroke-width:{width}px{f';stroke-dasharray:{dashes}' if dashes else ''}}}")
    shapes += [f".{name}{{fill-opacity:{opacity}}}" for name, (_, opacity) in FILLS.items()]
    shapes += [".none{stroke:none}"]
    dark = "".join(_colours(NIGHT))
    return "\n".join([*shapes, *_colours(PAPER), f"@media screen and (prefers-color-scheme:dark){{{dark}}}"])


def number(value):
    """Return a coordinate as text, to a hundredth of a pixel."""
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


@dataclass(frozen=True)
class View:
    """Where millimetres stand on the sheet: the pixel of (0, 0), and pixels per millimetre along both axes."""

    x: float
    y: float
    scale: float
    rise: float | None = None

    def __call__(self, x, z):
        """Return the pixel or pixels of points in millimetres."""
        return self.x + self.scale * np.asarray(x), self.y - (self.rise or self.scale) * np.asarray(z)


class Sheet:
    """A drawing."""

    def __init__(self, title, *, width=720, height):
        self.title, self.width, self.height = title, width, height
        self.parts, self.defs, self.clips = [], [], 0

    # Shapes

    def path(self, points, pen, *, close=False):
        """Draw straight lines through points, ((n,), (n,)) [px]."""
        steps = [f"{number(x)} {number(y)}" for x, y in zip(*points, strict=True)]
        self.parts.append(f'<path class="{pen}" d="M{"L".join(steps)}{"Z" * close}"/>')

    def line(self, start, end, pen="thin"):
        """Draw a line from one pixel to another."""
        (x, y), (u, v) = start, end
        self.parts.append(f'<line class="{pen}" x1="{number(x)}" y1="{number(y)}" x2="{number(u)}" y2="{number(v)}"/>')

    def box(self, at, size, pen, *, corner=0.0):
        """Draw a rectangle from its upper left corner."""
        self.parts.append(
            f'<rect class="{pen}" x="{number(at[0])}" y="{number(at[1])}" width="{number(size[0])}" '
            f'height="{number(size[1])}" rx="{number(corner)}"/>'
        )

    def circle(self, centre, radius, pen):
        """Draw a circle."""
        x, y = centre
        self.parts.append(f'<circle class="{pen}" cx="{number(x)}" cy="{number(y)}" r="{number(radius)}"/>')

    def ring(self, centre, radius, pen):
        """Draw a circle that is not filled."""
        angle = np.linspace(0, 2 * np.pi, 145)
        self.path((centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)), pen, close=True)

    def dot(self, at, ink="ink", radius=3.5):
        """Mark a point."""
        self.circle(at, radius, f"{ink} none")

    def material(self, points, *, name="hatch"):
        """Hatch the inside of a polygon, as a cut through material is."""
        if not any(f'"{name}"' in one for one in self.defs):
            self.defs.append(
                f'<pattern id="{name}" width="8" height="8" patternUnits="userSpaceOnUse" '
                'patternTransform="rotate(45)"><line class="faint" x1="0" y1="0" x2="0" y2="8"/></pattern>'
            )
        steps = [f"{number(x)} {number(y)}" for x, y in zip(*points, strict=True)]
        self.parts.append(f'<path d="M{"L".join(steps)}Z" style="fill:url(#{name})"/>')

    @contextmanager
    def inside(self, at, size):
        """Draw within a rectangle only."""
        self.clips += 1
        name = f"clip{self.clips}"
        self.defs.append(
            f'<clipPath id="{name}"><rect x="{number(at[0])}" y="{number(at[1])}" width="{number(size[0])}" '
            f'height="{number(size[1])}"/></clipPath>'
        )
        self.parts.append(f'<g clip-path="url(#{name})">')
        yield
        self.parts.append("</g>")

    # Arrows and dimensions

    def head(self, tip, along, ink, size=8.0):
        """Draw the head of an arrow."""
        way = np.asarray(along, dtype=float)
        way = way / np.hypot(*way)
        across = np.array([-way[1], way[0]])
        corners = np.array([tip, tip - size * way + 0.32 * size * across, tip - size * way - 0.32 * size * across])
        self.path(corners.T, f"{ink} none", close=True)

    def arrow(self, start, end, pen="thin", *, both=False):
        """Draw an arrow from one pixel to another."""
        start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
        way = (end - start) / np.hypot(*(end - start))
        ink = PENS[pen][0]
        self.line(start + 5 * both * way, end - 5 * way, pen)
        self.head(end, way, ink)
        if both:
            self.head(start, -way, ink)

    def arc(self, centre, radius, start, end, pen="thin", *, arrow=False, both=False):
        """Draw an arc between two angles, counter-clockwise from the right where they grow. [px], [deg]"""
        angle = np.deg2rad(np.linspace(start, end, 65))
        ink, side = PENS[pen][0], np.sign(end - start)
        shown = angle.copy()
        if arrow or both:
            shown = np.linspace(angle[0] + both * side * 5 / radius, angle[-1] - side * 5 / radius, 65)
        x, y = centre
        self.path((x + radius * np.cos(shown), y - radius * np.sin(shown)), pen)
        for at, way in ((angle[-1], side), *([(angle[0], -side)] if both else [])) if arrow or both else ():
            tip = np.array([x + radius * np.cos(at), y - radius * np.sin(at)])
            turn = at - way * 4 / radius
            self.head(tip, (-way * np.sin(turn), -way * np.cos(turn)), ink)

    def dimension(self, start, end, label, *, text=None, anchor="middle", pen="thin", ink="quiet", reach=()):
        """Draw a dimension line with its extension lines, which begin at the pixels of `reach`."""
        for near, far in zip(reach, (start, end), strict=False):
            near, far = np.asarray(near, dtype=float), np.asarray(far, dtype=float)  # noqa: PLW2901
            if (length := np.hypot(*(far - near))) > 5:
                way = (far - near) / length
                self.line(near + 3 * way, far + 4 * way, "thin")
        (x, y), (u, v) = start, end
        if np.hypot(u - x, v - y) > 18:
            self.arrow(start, end, pen, both=True)
        else:  # the arrows stand outside
            way = np.array([u - x, v - y]) / np.hypot(u - x, v - y)
            self.arrow(np.array(start) - 18 * way, start, pen)
            self.arrow(np.array(end) + 18 * way, end, pen)
        self.text(text or ((x + u) / 2, (y + v) / 2 - 5), label, anchor=anchor, ink=ink)

    # Text

    def text(self, at, label, *, anchor="start", ink="ink", size=""):
        """Write a line of text: *italic*, _{subscript}, ^{superscript}."""
        spans, raised = [], 0
        for slanted, low, high, plain in MARKUP.findall(label):
            level = 4 if low else -5 if high else 0
            wears = ' font-style="italic"' if slanted else f' font-size="{LEAST}"' if level else ""
            shift = f' dy="{level - raised}"' if level != raised else ""
            raised = level
            words = escape(slanted or low or high or plain)
            spans.append(f"<tspan{wears}{shift}>{words}</tspan>" if wears or shift else words)
        place = f'x="{number(at[0])}" y="{number(at[1])}"'
        ends = "" if anchor == "start" else f' text-anchor="{anchor}"'
        self.parts.append(f'<text class="{f"{size} " if size else ""}{ink}" {place}{ends}>{"".join(spans)}</text>')

    def lines(self, at, labels, *, step=18, **how):
        """Write lines of text one below the other."""
        for row, label in enumerate(labels):
            self.text((at[0], at[1] + step * row), label, **how)

    def svg(self):
        """Return the drawing as the text of its file."""
        size = f'width="{self.width}" height="{self.height}" viewBox="0 0 {self.width} {self.height}"'
        edge = f'x="0.5" y="0.5" width="{self.width - 1}" height="{self.height - 1}" rx="6"'
        return "\n".join([
            f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">',
            f"<title>{escape(self.title)}</title>",
            f"<style>{style()}</style>",
            "<defs>", *self.defs, "</defs>",
            f'<rect class="ground" {edge}/>',
            *self.parts,
            "</svg>",
            "",
        ])  # fmt: skip
