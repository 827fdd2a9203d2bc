"""Signatures of a tool centring error and of a tool height error."""

from dataclasses import replace

import numpy as np

import turnwright as tw
from docs.drawings.sheet import Sheet, View

TOOL = tw.Tool(nose_radius=0.3, included=np.deg2rad(140))
OFFSET, CURVED, REACH = 0.2, 3.2, 1.9  # of the tip, radius of curvature, radius of the part [mm]
AT = np.linspace(0.0, REACH, 191)


def cut(surface, offset):
    """Return the heights along +x that are cut with an offset of the tip along X. [mm]"""
    part = tw.Part(surface=surface, radius=REACH)
    servo = tw.SlowToolServo(feed=0.02, points_per_rev=24, spindle_rpm=60, lead_in=0.4)
    motion = tw.drive(tw.place(servo.spiral(part, TOOL), part, TOOL), servo, tw.Machine.load("generic"))
    return tw.generate_polar(motion, replace(TOOL, offset=(offset, 0.0, 0.0)), radius=AT, angle=[0.0]).z[0]


def profile(sheet, left, title, surface, offset):
    """Draw design, cut and error of one part."""
    view, low = View(left + 108, 142, 52), View(left + 108, 236, 52, 170)
    x = np.concatenate([-AT[:0:-1], AT])
    design, height = surface.sag(x, 0 * x), cut(surface, offset)
    height = np.concatenate([height[:0:-1], height])
    sheet.text((left, 60), title)
    made = view(x, height)
    sheet.material(tuple(np.append(one, more) for one, more in zip(made, (made[0][[-1, 0]], (180, 180)), strict=True)))
    sheet.path(view(x, design), "dashed")
    sheet.path(made, "outline")
    sheet.line((left + 108, 84), (left + 108, 258), "centre")
    sheet.line(low(-REACH, 0), low(REACH, 0))
    sheet.path(low(x, height - design), "wrong")


def centring(sheet):
    """Draw what an offset along X does to a concave sphere and to a flat."""
    sheet.text((24, 34), "Tool centring error, offset d*x*: an ogive", size="head")
    bowl = tw.Sphere(radius=CURVED)
    profile(sheet, 24, "concave sphere, d*x* > 0", bowl, OFFSET)
    profile(sheet, 254, "concave sphere, d*x* < 0", bowl, -OFFSET)
    profile(sheet, 484, "flat: nothing but the core", tw.Plane(), OFFSET)
    sheet.text((24, 200), "cut minus design", size="small", ink="bad")
    sheet.text((24, 282), "error ≈ −d*x* *f* ′(*ρ*) ≈ −d*x* *ρ*/*R*;   off the best-fit sphere over the diameter *A*: "
               "PV = |d*x*| *A* / 8*R*")  # fmt: skip


def core(sheet, left, shape):
    """Draw a core in section."""
    foot, half, top = 420, 44, 344
    middle = left + 85
    if shape == "cone":
        outline = ([left, middle - half, middle, middle + half, left + 170], [foot, foot, top, foot, foot])
    else:
        outline = (
            [left, middle - half, middle - half, middle + half, middle + half, left + 170],
            [foot, foot, top, top, foot, foot],
        )
    sheet.material(tuple([*one, *more] for one, more in zip(outline, ([left + 170, left], [450, 450]), strict=True)))
    sheet.path(outline, "outline")
    sheet.line((middle, 332), (middle, 464), "centre")
    sheet.dimension((middle, 434), (middle + half, 434), "|d*y*|", text=(middle + half + 8, 444), anchor="start")


def height_error(sheet):
    """Draw the core that a tip above or below the centre leaves."""
    sheet.text((24, 330), "Tool height error, offset d*y*: a core", size="head")
    middle = 150, 418
    sheet.ring(middle, 44, "outline")
    around = np.linspace(0, 2 * np.pi, 97)
    sheet.material((middle[0] + 44 * np.cos(around), middle[1] + 44 * np.sin(around)))
    sheet.line((60, 418), (244, 418), "centre")
    sheet.line((150, 352), (150, 478), "centre")
    sheet.arrow((240, 374), middle_top := (150, 374), "tool")
    sheet.dot(middle_top, "accent")
    sheet.text((196, 364), "path of the tip", ink="accent", anchor="middle", size="small")
    sheet.dimension((92, 418), (92, 374), "d*y*", reach=((150, 418), middle_top), text=(84, 400), anchor="end")
    sheet.text((248, 422), "X", ink="quiet")
    sheet.text((24, 497), "seen from the tool", size="small", ink="quiet")
    core(sheet, 300, "cone")
    sheet.text((385, 476), "tip above centre: cone", anchor="middle")
    core(sheet, 520, "cylinder")
    sheet.text((605, 476), "tip below centre: cylinder", anchor="middle")
    sheet.text((300, 497), "the radius follows from geometry, the shape from experience", size="small", ink="quiet")


def draw():
    """Return the drawing."""
    sheet = Sheet("Ogive of a decentred tool, and the core of a tool height error", height=512)
    centring(sheet)
    sheet.line((24, 300), (696, 300), "faint")
    height_error(sheet)
    return sheet
