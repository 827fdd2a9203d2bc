"""Where the chip is thicker than critical, and how deep cracks from there may reach."""

import numpy as np
from scipy.optimize import brentq

import turnwright as tw
from docs.drawings.chip import chip_outline, edge, section
from docs.drawings.sheet import Sheet, View

CRITICAL = 0.05  # critical chip thickness [mm]
FINE, COARSE = (tw.cutting.RoundChip(nose_radius=1.0, feed=feed, depth=0.15) for feed in (0.12, 0.25))


def panel(sheet, left, chip, title):
    """Draw the chip and the crack of the ductile-mode check."""
    view = View(left + 220, 190, 330)
    sheet.text((left, 34), title, size="head")
    with sheet.inside((left, 50), (330, 236)):
        section(sheet, view, chip, far=-0.67, reach=0.34, foot=-0.26)
        sheet.path(view(*chip_outline(chip)), "chip none", close=True)
        # The chip is critical twice: on the arc and, beyond the corner, below the stock.
        first = brentq(lambda sweep: float(chip.thickness(sweep)) - CRITICAL, 0.0, chip.corner)
        last = brentq(lambda sweep: float(chip.thickness(sweep)) - CRITICAL, chip.corner, chip.sweep[1])
        sheet.path(view(*chip_outline(chip, first, last)), "broken none", close=True)
        sheet.path(view(*chip_outline(chip)), "chipline", close=True)
        finish = view([-0.67, 0.34], [0, 0])
        sheet.line(*zip(*finish, strict=True), "dashed")
        base = edge(first, chip)
        crack = view(base[0], base[1]), view(base[0], base[1] - chip.thickest)
        rough = np.array([0, 4, -3, 3, -2, 0])
        sheet.path((crack[0][0] + rough, np.linspace(crack[0][1], crack[1][1], 6)), "wrong")
        sheet.dot(crack[0], "bad", 3.5)
    sheet.text((left + 226, 208), "tip", size="small", ink="quiet")
    sheet.dot(view(0, 0), radius=3)
    corner = view(*edge(chip.corner, chip, inside=chip.thickest))
    sheet.line(corner, (corner[0] - 22, 88))
    sheet.text((corner[0] - 26, 82), "*t* > *t*_{c}: brittle", ink="bad", anchor="middle")
    limit = view(*edge(first, chip)), view(*edge(first, chip, inside=CRITICAL))
    sheet.line(*limit, "outline")
    sheet.line(limit[1], (limit[1][0] + 34, 88))
    sheet.text((limit[1][0] + 30, 82), "*t* = *t*_{c}")
    return view, crack


def draw():
    """Return the drawing."""
    sheet = Sheet("Ductile and brittle parts of the chip, and the depth of damage", height=350)
    note = {"size": "small", "ink": "quiet", "step": 17}
    view, crack = panel(sheet, 24, FINE, "Small feed: cracks are cut away")
    start = crack[0]
    x, finished = start[0] - 28, view(0, 0)[1]
    sheet.dimension((x, finished), (x, start[1]), "*e*(*s*_{c})", text=(x - 8, 183), anchor="end")
    sheet.line((x - 4, start[1]), start)
    sheet.text((24, 208), "finished surface", size="small", ink="quiet")
    lines = "*t*_{max} < *e*(*s*_{c}): the crack ends above the", "finished surface, later revolutions take it off"
    sheet.lines((24, 312), lines, **note)
    sheet.line((360, 50), (360, 336), "faint")

    view, crack = panel(sheet, 376, COARSE, "Large feed: damage stays")
    start, end = crack
    x, finished = start[0] - 40, view(0, 0)[1]
    sheet.dimension((x, finished), (x, end[1]), "damage", text=(x - 8, 206), anchor="end", ink="bad")
    sheet.line((x - 4, end[1]), end)
    sheet.text((x - 8, 222), "depth *y*", ink="bad", anchor="end")
    lines = "*y* = *k* *t*_{max} − *e*(*s*_{c}) > 0, here *k* = 1:", "the crack reaches below the finished surface"
    sheet.lines((376, 312), lines, **note)
    return sheet
