"""A wavy edge: its radial deviation, and the contact that it moves."""

import numpy as np

import turnwright as tw
from docs.drawings.sheet import Sheet, View

AMPLITUDE, WAVES = 0.02, 6.0  # dR = AMPLITUDE sin(WAVES φ) [mm]
SWEEPS = np.deg2rad(np.linspace(-56, 56, 225))
TABLE = tw.WavinessTable(sweep=SWEEPS, deviation=AMPLITUDE * np.sin(WAVES * SWEEPS))
WAVY = tw.Tool(nose_radius=1.0, included=np.deg2rad(112), waviness=TABLE)
ROUND = tw.Tool(nose_radius=1.0, included=np.deg2rad(112))
SLOPE = np.deg2rad(27)


def contact():
    """Return height of the tip and sweep at the contact, on a plane of the slope, as `place` finds them."""
    plane = tw.Part(surface=tw.Plane(slope=(np.tan(SLOPE), 0.0)), radius=5.0)
    path = tw.place(tw.Spiral(angle=np.array([0.0, 1e-3]), radius=np.array([2.0, 2.0])), plane, WAVY)
    return path.z[0] - 2 * np.tan(SLOPE), path.sweep[0]


def touching(sheet, z, sweep):
    """Draw the edge on the slope, and where a circle would touch."""
    view = View(178, 330, 190)
    sheet.text((24, 34), "Edge on a slope of angle *φ*′", size="head")
    ends = np.array([-0.66, 0.98])
    line = view(ends, np.tan(SLOPE) * ends)
    sheet.material(tuple(np.append(one, more) for one, more in zip(line, (line[0][::-1], (394, 394)), strict=True)))
    sheet.path(line, "outline")
    u, _, e = WAVY.edge(SWEEPS)
    edge = view(u, z + e)
    sheet.path(edge, "diamond none", close=True)
    sheet.path(view(np.sin(SWEEPS), z + 1 - np.cos(SWEEPS)), "dashed")
    sheet.path(edge, "tool")
    centre = view(0, z + 1)
    sheet.line((centre[0], centre[1] - 20), (centre[0], view(0, z)[1] + 14), "centre")
    sheet.dot(centre, "quiet", 3)
    for tool, angle, pen, ink in ((ROUND, SLOPE, "dashed", "quiet"), (WAVY, sweep, "wrongthin", "bad")):
        u, _, e = (one[0] for one in tool.edge(np.array([angle])))
        point = view(u, z + e)
        sheet.line(centre, point, pen)
        sheet.dot(point, ink, 4)
        label, down = ("contact", 34) if ink == "bad" else ("of a circle", 18)
        sheet.text((point[0] + 13, point[1] + down), label, ink=ink, size="small")
    sheet.arc(centre, 92, -90, -90 + np.rad2deg(SLOPE), arrow=True)
    sheet.text((centre[0] + 14, centre[1] + 112), "*φ*′", ink="quiet")
    sheet.arc(centre, 62, -90, -90 + np.rad2deg(sweep), "wrongthin", arrow=True)
    sheet.text((centre[0] + 14, centre[1] + 54), "*φ*", ink="bad")
    sheet.text((36, 102), "real edge, *R* + d*R*(*φ*)", ink="accent", size="small")
    sheet.text((36, 120), "circle of radius *R*", ink="quiet", size="small")
    sheet.text((24, 414), "*φ* = *φ*′ + arctan( d*R*′ / (*R* + d*R*) )")


def deviation(sheet, sweep):
    """Draw the deviation over the sweep."""
    chart = View(546, 132, 2.3, 2200)
    sheet.text((400, 34), "Deviation over the sweep", size="head")
    sheet.line(chart(-58, 0), chart(62, 0))
    sheet.line(chart(0, -0.026), chart(0, 0.026))
    sheet.path(chart(np.rad2deg(SWEEPS), WAVY.deviation(SWEEPS)), "tool")
    sheet.text((690, 148), "*φ*", anchor="end")
    sheet.text((690, 60), "d*R* > 0: outward, cuts deeper", anchor="end", size="small", ink="quiet")
    for angle, ink in ((SLOPE, "quiet"), (sweep, "bad")):
        sheet.dot(chart(np.rad2deg(angle), WAVY.deviation(angle)), ink, 4)
    along = np.deg2rad([-9, 9])
    rise = AMPLITUDE * WAVES * np.cos(WAVES * sweep)
    sheet.path(chart(np.rad2deg(sweep + along), WAVY.deviation(sweep) + rise * along), "wrongthin")
    sheet.text((chart(np.rad2deg(sweep), 0)[0] + 20, 104), "slope d*R*′", ink="bad")


def gap(sheet, z, sweep):
    """Draw how far the edge is from the slope, exactly placed and by the circle's contact."""
    close = View(520, 340, 420, 5000)
    # The circle's height, corrected by the deviation where the circle touches.
    simple = (1 + float(WAVY.deviation(SLOPE))) / np.cos(SLOPE) - 1
    sheet.text((400, 226), "Gap to the surface, enlarged", size="head")
    u, _, e = WAVY.edge(np.linspace(SLOPE - 0.5, SLOPE + 0.5, 161))
    middle = WAVY.edge(np.array([sweep]))[0][0] / np.cos(SLOPE)
    with sheet.inside((400, 240), (300, 128)):
        sheet.material(([400, 700, 700, 400], [340, 340, 368, 368]))
        for height, pen in ((z, "tool"), (simple, "wrongdashed")):
            along = np.cos(SLOPE) * u + np.sin(SLOPE) * (height + e) - middle
            sheet.path(close(along, np.cos(SLOPE) * (height + e) - np.sin(SLOPE) * u), pen)
        sheet.line((400, 340), (700, 340), "outline")
    sheet.dot((520, 340), "bad", 4)
    sheet.text((512, 330), "contact", ink="bad", anchor="end", size="small")
    depth = f"corrected at the unmoved contact: {1e3 * (z - simple):.1f} µm"
    sheet.lines((400, 388), [depth, "too deep, for *R* = 1 mm and waves of ±20 µm"], ink="bad", size="small", step=17)


def draw():
    """Return the drawing."""
    z, sweep = contact()
    sheet = Sheet("Waviness of the nose and the moved contact", height=430)
    touching(sheet, z, sweep)
    deviation(sheet, sweep)
    gap(sheet, z, sweep)
    return sheet
