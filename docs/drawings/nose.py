"""The nose of the tool in its rake plane, and the angles of its faces."""

import numpy as np

import turnwright as tw
from docs.drawings.sheet import Sheet, View

TOOL = tw.Tool(nose_radius=1.0, included=np.deg2rad(110))
SWEEP = np.deg2rad(32)
RAKE, CLEARANCE = np.deg2rad(12), np.deg2rad(10)


def rake_plane(sheet):
    """Draw the edge as the rake plane holds it."""
    view = View(212, 310, 168)
    sheet.text((24, 34), "In the rake plane", size="head")
    reach = TOOL.arc[1] + 0.42
    edge = view(*TOOL.edge(np.linspace(-reach, reach, 161))[::2])
    sheet.path(edge, "diamond none", close=True)
    sheet.path(edge, "tool")
    centre, tip = view(0, TOOL.nose_radius), view(0, 0)
    for side in (-1, 1):
        beyond = side * np.linspace(TOOL.arc[1], np.deg2rad(116), 61)
        sheet.path(view(np.sin(beyond), 1 - np.cos(beyond)), "dashed")
    u, _, e = (one[0] for one in TOOL.edge(np.array([SWEEP])))
    point = view(u, e)
    sheet.line((centre[0], centre[1] - 46), (tip[0], tip[1] + 14), "centre")
    sheet.line(centre, point, "thin")
    for side in TOOL.arc:
        end = [one[0] for one in TOOL.edge(np.array([side]))]
        sheet.line(centre, view(end[0], end[2]), "centre")
    sheet.arc(centre, 62, -90, -90 + np.rad2deg(SWEEP), arrow=True)
    sheet.text((centre[0] + 10, centre[1] + 82), "*φ*", ink="quiet")
    half = np.rad2deg(TOOL.included / 2)
    sheet.arc(centre, 34, -90 - half, -90 + half, both=True)
    sheet.text((centre[0] - 36, centre[1] + 34), "included", anchor="end", ink="quiet")
    sheet.text((centre[0] + 58, centre[1] + 66), "*R*")
    sheet.dot(centre, "quiet", 3)
    sheet.dot(tip)
    sheet.dot(point)
    sheet.text((tip[0] - 10, tip[1] + 18), "tip", anchor="end")
    sheet.line((tip[0] - 60, tip[1]), (tip[0] + 190, tip[1]), "thin")
    sheet.dimension((tip[0], tip[1] + 32), (point[0], tip[1] + 32), "*u* = *R* sin *φ*", reach=(tip, point),
                    text=((tip[0] + point[0]) / 2, tip[1] + 50))  # fmt: skip
    sheet.dimension((point[0] + 58, tip[1]), (point[0] + 58, point[1]), "*e*(*u*)", reach=(tip, point),
                    text=(point[0] + 68, tip[1] - 8), anchor="start")  # fmt: skip
    sheet.text((40, 226), "flank", ink="accent", anchor="middle")
    sheet.arrow((28, tip[1] + 52), (88, tip[1] + 52), "outline")
    sheet.text((28, tip[1] + 44), "+X")
    sheet.text((24, 402), "*e*(*u*) = *R* − √(*R*² − *u*²) on the arc; beyond it, straight flanks along the tangent")


def section(sheet):
    """Draw the faces across the edge."""
    tip = 570, 290
    sheet.text((440, 34), "Across the edge, seen along −X", size="head")
    face = tip[0] - 190 * np.sin(RAKE), tip[1] - 190 * np.cos(RAKE)
    under = tip[0] - 130 * np.cos(CLEARANCE), tip[1] - 130 * np.sin(CLEARANCE)
    body = ([face[0], tip[0], under[0], under[0]], [face[1], tip[1], under[1], face[1]])
    sheet.path(body, "diamond none", close=True)
    sheet.path(([face[0], tip[0], under[0]], [face[1], tip[1], under[1]]), "tool")
    ground = ([440, tip[0], tip[0], 704, 704, 440], [290, 290, 268, 268, 330, 330])
    sheet.material(ground)
    sheet.path((ground[0][:4], ground[1][:4]), "outline")
    sheet.line(tip, (tip[0], 84), "centre")
    sheet.dot(tip)
    sheet.arc(tip, 160, 90, 90 + np.rad2deg(RAKE), arrow=True)
    sheet.text((tip[0] + 8, 122), "rake *γ* > 0")
    sheet.arc(tip, 100, 180, 180 - np.rad2deg(CLEARANCE), both=True)
    sheet.text((under[0] + 4, 258), "clearance *α*", anchor="start")
    sheet.arrow((606, 220), (676, 220), "outline")
    sheet.lines((606, 190), ["the tool cuts", "this way"], size="small", ink="quiet", step=16)
    sheet.text((637, 306), "part", anchor="middle")
    sheet.lines((440, 366), ["*γ* positive: the rake face leans back", "from the cutting direction"],
                size="small", ink="quiet")  # fmt: skip


def draw():
    """Return the drawing."""
    sheet = Sheet("The nose: radius, sweep, included angle, rake and clearance", height=420)
    rake_plane(sheet)
    sheet.line((424, 50), (424, 376), "faint")
    section(sheet)
    return sheet
