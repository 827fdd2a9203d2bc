"""The edge brought into contact along Z, and along the normal."""

import numpy as np

import turnwright as tw
from docs.drawings.sheet import Sheet, View

PART = tw.Part(surface=tw.Sphere(radius=3.0), radius=2.4)
TOOL = tw.Tool(nose_radius=0.9, included=np.deg2rad(140))
SENT = 1.15  # where the spiral sends the tool [mm]


def panel(sheet, left, along):
    """Draw part and edge, and return the view, the tip, the contact and the sweep there."""
    spiral = tw.Spiral(angle=np.array([0.0, 1e-3]), radius=np.array([SENT, SENT]))
    path = tw.place(spiral, PART, TOOL, along=along)
    view = View(left + 20, 330, 142)
    x = np.linspace(-0.05, 2.2, 161)
    surface = view(x, PART.surface.sag(x, 0 * x))
    ground = tuple(np.append(one, more) for one, more in zip(surface, (surface[0][[-1, 0]], (366, 366)), strict=True))
    sheet.material(ground)
    half = TOOL.arc[1] + 0.1
    u, _, e = TOOL.edge(np.linspace(-half, half, 161))
    edge = view(path.radius[0] + u, path.z[0] + e)
    sheet.path(edge, "diamond none", close=True)
    sheet.path(surface, "outline")
    sheet.path(edge, "tool")
    sheet.line(view(0, -0.14), view(0, 1.55), "centre")
    sheet.text(view(0.04, 1.5), "axis", size="small", ink="quiet")
    return view, (path.radius[0], path.z[0]), (path.contact_x[0], path.contact_z[0]), path.sweep[0]


def along_z(sheet):
    """Draw the highest of all heights at which some point of the edge touches."""
    sheet.text((24, 34), "Along z: only Z moves", size="head")
    view, (radius, z), (x, height), _ = panel(sheet, 20, "z")
    tip, contact = view(radius, z), view(x, height)
    sheet.line((tip[0] - 18, tip[1]), (contact[0] + 50, tip[1]))
    sheet.arrow((tip[0], 96), (tip[0], tip[1] - 4), "chipline")
    sheet.text((tip[0] - 8, 122), "lower along Z", anchor="end", ink="warn", size="small")
    low = 390
    sheet.dimension((40, low), (tip[0], low), "*ρ*", reach=(view(0, 0), tip), text=((40 + tip[0]) / 2, low - 5))
    sheet.dimension((tip[0], low), (contact[0], low), "*u*", reach=(tip, contact))
    sheet.dimension((contact[0] + 38, tip[1]), (contact[0] + 38, contact[1]), "*e*(*u*)", reach=(tip, contact),
                    text=(contact[0] + 46, (tip[1] + contact[1]) / 2 + 4), anchor="start")  # fmt: skip
    sheet.dimension((tip[0] - 44, 330), (tip[0] - 44, tip[1]), "*Z*", reach=(view(0, 0), tip),
                    text=(tip[0] - 50, (330 + tip[1]) / 2 + 5), anchor="end")  # fmt: skip
    sheet.dot(contact, "bad", 4.5)
    sheet.dot(tip)
    sheet.text((tip[0] + 8, tip[1] + 17), "tip")
    sheet.text((contact[0] - 12, contact[1] - 6), "contact", anchor="end", ink="bad")
    sheet.text((24, 424), "*Z*(*ρ*) = max over *u* of [*f*(*ρ* + *u*) − *e*(*u*)]")


def along_normal(sheet):
    """Draw the tip moved in X and Z, with the contact where the spiral sends it."""
    sheet.text((384, 34), "Along the normal: X and Z move", size="head")
    view, (radius, z), (x, height), sweep = panel(sheet, 380, "normal")
    tip, contact = view(radius, z), view(x, height)
    centre = view(radius, z + TOOL.nose_radius)
    sheet.line((centre[0], centre[1] - 14), (tip[0], tip[1] + 12), "centre")
    sheet.arrow(contact, centre, "chipline")
    sheet.text(((contact[0] + centre[0]) / 2 + 10, (contact[1] + centre[1]) / 2 - 4), "*R*", ink="warn")
    sheet.text((centre[0] + 10, centre[1]), "normal", ink="warn", size="small")
    sheet.arc(centre, 56, -90, -90 + np.rad2deg(sweep), arrow=True)
    sheet.text((centre[0] + 6, centre[1] + 74), "*φ*", ink="quiet")
    low = 396
    sheet.dimension((400, low), (contact[0], low), "*ρ* of the spiral", reach=(view(0, 0), contact))
    sheet.dimension((tip[0], 346), (contact[0], 346), "*R* sin *φ*", reach=(tip, contact),
                    text=((tip[0] + contact[0]) / 2, 363))  # fmt: skip
    sheet.dot(contact, "bad", 4.5)
    sheet.dot(tip)
    sheet.dot(centre, "quiet", 3)
    sheet.text((contact[0] + 12, contact[1] + 6), "contact", ink="bad")
    sheet.text((tip[0] - 10, tip[1] - 8), "tip", anchor="end")
    sheet.text((384, 424), "*ρ*′ = *ρ* − *R* sin *φ*,   *Z* = *f*(*ρ*) + *R* cos *φ* − *R*")


def draw():
    """Return the drawing."""
    sheet = Sheet("Placing the edge along z and along the normal", height=444)
    along_z(sheet)
    sheet.line((368, 50), (368, 424), "faint")
    along_normal(sheet)
    return sheet
