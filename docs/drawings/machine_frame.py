"""The machine frame and its signs, from above and as the tool sees the part."""

import numpy as np

import turnwright as tw
from docs.drawings.sheet import Sheet, View

PART = tw.Part(surface=tw.Sphere(radius=15.0), radius=10.0)
TOOL = tw.Tool(nose_radius=3.0, included=np.deg2rad(100))
AT = 6.5  # distance of the tip from the axis [mm]
TURNED = 35  # how far the part has turned [deg]


def from_above(sheet):
    """Draw spindle, part and tool in the plane of X and Z."""
    view = View(186, 232, 10)
    sheet.text((24, 34), "Seen from above", size="head")
    x = np.linspace(-PART.radius, PART.radius, 121)
    front = view(PART.surface.sag(x, 0 * x), x)
    back = view([-5, -5], [PART.radius, -PART.radius])
    outline = tuple(np.concatenate(both) for both in zip(front, back, strict=True))
    sheet.material(outline)
    sheet.path(outline, "outline", close=True)
    sheet.box((112, 142), (24, 180), "outline")
    sheet.box((34, 182), (78, 100), "outline")
    sheet.text((73, 216), "spindle", anchor="middle")
    sheet.text((160, 350), "part", anchor="middle")
    sheet.line((22, 232), (352, 232), "centre")

    path = tw.place(tw.Spiral(angle=np.array([0.0, 1e-3]), radius=np.array([AT, AT])), PART, TOOL)
    half = TOOL.arc[1] + 0.9
    u, _, e = TOOL.edge(np.linspace(-half, half, 121))
    edge = view(path.z[0] + e, AT + u)
    body = tuple(np.append(one, [end, end]) for one, end in zip(edge, (0, 0), strict=True))
    body[0][-2:], body[1][-2:] = edge[0][-1] + 26, (edge[1][-1], edge[1][0])
    sheet.path(body, "diamond none", close=True)
    sheet.path(edge, "tool")
    tip = view(path.z[0], AT)
    sheet.dot(tip)
    sheet.text((262, 166), "tool", ink="accent")

    origin = view(0, 0)
    sheet.arrow(origin, (345, 232), "outline")
    sheet.text((336, 222), "*z*, Z")
    sheet.arrow(origin, (origin[0], 74), "outline")
    sheet.text((origin[0] + 10, 82), "*x*, X")
    sheet.dot(origin)
    sheet.text((origin[0] + 8, 250), "vertex")
    sheet.dimension((tip[0], 232), tip, "X", text=(tip[0] + 8, 220), anchor="start")
    sheet.dimension((origin[0], 120), (tip[0], 120), "Z", reach=(origin, tip), text=(tip[0] + 24, 124), anchor="start")
    sheet.lines((24, 386), [
        "+X: away from the axis, on the side of the tool",
        "+Z: out of the part, toward the tool",
        "concave surface: radius of curvature > 0",
    ], size="small", ink="quiet")  # fmt: skip


def from_the_tool(sheet):
    """Draw the part in the plane of X and Y, with the sense of rotation."""
    middle, radius = (536, 232), 100
    sheet.text((392, 34), "Seen from the tool, along −Z", size="head")
    sheet.ring(middle, radius, "outline")
    sheet.line((middle[0] - 118, 232), (middle[0] + 100, 232), "centre")
    sheet.arrow(middle, (700, 232), "outline")
    sheet.text((686, 222), "X")
    sheet.arrow(middle, (middle[0], 74), "outline")
    sheet.text((middle[0] + 10, 82), "Y, tool height")
    turn = np.deg2rad(TURNED)
    for name, way in (("x", -turn), ("y", np.pi / 2 - turn)):
        end = middle[0] + 88 * np.cos(way), middle[1] - 88 * np.sin(way)
        sheet.arrow(middle, end, "thin")
        side = (-16, 4) if name == "x" else (-4, -6)
        sheet.text((end[0] + side[0], end[1] + side[1] + (12 if name == "x" else 0)), f"*{name}*", ink="quiet")
    sheet.dot(middle)
    sheet.text((middle[0] - 10, 250), "*z* toward you", anchor="end", ink="quiet", size="small")

    tip = middle[0] + 60, 232
    sheet.box((tip[0] - 11, 232), (22, 118), "diamond none")
    sheet.path(([tip[0] - 11, tip[0] - 11, tip[0] + 11, tip[0] + 11], [350, 232, 232, 350]), "tool")
    sheet.dot(tip)
    sheet.text((tip[0], 366), "tool, rake face up", ink="accent", anchor="middle")
    sheet.arc(middle, 42, -TURNED, 0, "chipline", arrow=True)
    sheet.text((middle[0] + 45, 222), "C = *θ*", ink="warn", anchor="middle")
    sheet.arc(middle, 113, 158, 112, "wrong", arrow=True)
    sheet.lines((392, 112), ["sense +1,", "M04"], ink="bad")
    sheet.arc(middle, 113, 202, 248, "wrongdashed", arrow=True)
    sheet.lines((392, 338), ["sense −1,", "M03"], ink="bad")
    sheet.lines((392, 386), [
        "+C: azimuth of the part under the tool grows,",
        "clockwise seen from here, as M04",
        "offset d*y* > 0: tip above centre",
    ], size="small", ink="quiet")  # fmt: skip


def draw():
    """Return the drawing."""
    sheet = Sheet("Machine frame and signs: X, Z, C, Y, tool height, M03 and M04", height=440)
    from_above(sheet)
    sheet.line((372, 50), (372, 420), "faint")
    from_the_tool(sheet)
    return sheet
