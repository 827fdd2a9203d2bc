"""The uncut chip of a round nose, to scale."""

import numpy as np

import turnwright as tw
from docs.drawings.sheet import Sheet, View

CHIP = tw.cutting.RoundChip(nose_radius=1.0, feed=0.2, depth=0.16)


def edge(sweep, chip=CHIP, *, at=0.0, inside=0.0):
    """Return points of the edge, or inside it along its normal; the uncut side is on the left. ((n,), (n,)) [mm]"""
    radius = chip.nose_radius - np.asarray(inside)
    return at - radius * np.sin(sweep), chip.nose_radius - radius * np.cos(sweep)


def chip_outline(chip=CHIP, first=None, last=None):
    """Return the outline of a part of the chip, from one sweep to another. ((n,), (n,)) [mm]"""
    low, high = chip.sweep
    # The corner, where the last revolution meets the stock, is a point of the outline.
    sweep = np.linspace(low if first is None else first, high if last is None else last, 241)
    sweep = np.sort(np.append(sweep, chip.corner)) if sweep[0] < chip.corner < sweep[-1] else sweep
    below, above = edge(sweep, chip), edge(sweep[::-1], chip, inside=chip.thickness(sweep[::-1]))
    return tuple(np.concatenate(both) for both in zip(below, above, strict=True))


def left_behind(chip=CHIP, reach=0.5):
    """Return the finished surface on the right of the tip, cusps included. ((n,), (n,)) [mm]"""
    x = np.linspace(chip.feed / 2, reach, 241)
    away = np.remainder(x - chip.feed / 2, chip.feed) - chip.feed / 2
    return x, chip.nose_radius - np.sqrt(chip.nose_radius**2 - away**2)


def section(sheet, view, chip=CHIP, *, far=-0.98, reach=0.5, foot=-0.14):
    """Draw stock, finished surface and the two edges."""
    low, high = chip.sweep
    below = edge(np.linspace(high, low, 121), chip)
    right = left_behind(chip, reach)
    top = [np.concatenate(([start], *parts)) for start, *parts in zip((far, chip.depth), below, right, strict=True)]
    ground = tuple(np.append(one, more) for one, more in zip(top, ((reach, far), (foot, foot)), strict=True))
    sheet.material(view(*ground))
    end = edge(chip.corner, chip, inside=chip.thickest)
    sheet.path(view([far, end[0]], [chip.depth, chip.depth]), "outline")
    sheet.path(view(*right), "outline")
    for at, pen in ((chip.feed, "tooldashed"), (0.0, "tool")):
        sweep = np.linspace(-high - 0.12, high + 0.12, 161)
        if pen == "tool":
            sheet.path(view(*edge(sweep, chip)), "diamond none", close=True)
        sheet.path(view(*edge(sweep, chip, at=at)), pen)


def thickness(sheet, view, sweep, chip=CHIP, pen="outline"):
    """Draw the thickness at one sweep, and return the middle of it."""
    start, end = view(*edge(sweep, chip)), view(*edge(sweep, chip, inside=chip.thickness(sweep)))
    sheet.line(start, end, pen)
    return start, end


def draw():
    """Return the drawing."""
    sheet = Sheet("Uncut chip thickness of a round nose", height=380)
    view = View(430, 280, 400)
    with sheet.inside((24, 40), (672, 300)):
        section(sheet, view, reach=0.6)
    sheet.path(view(*chip_outline()), "chip none", close=True)
    sheet.path(view(*chip_outline()), "chipline", close=True)
    tip, before = view(0, 0), view(CHIP.feed, 0)
    sheet.dot(tip)
    sheet.dot(before, "quiet")
    sheet.dimension((tip[0], 306), (before[0], 306), "feed *f*", reach=(tip, before),
                    text=((tip[0] + before[0]) / 2, 326))  # fmt: skip
    high = CHIP.sweep[1]
    depth_x = view(-0.8, 0)[0]
    sheet.line((depth_x - 16, tip[1]), tip, "dashed")
    sheet.dimension((depth_x, tip[1]), (depth_x, view(0, CHIP.depth)[1]), "*d*", text=(depth_x - 8, 252), anchor="end")
    sheet.text((depth_x - 40, view(0, CHIP.depth)[1] - 8), "stock")

    start, end = thickness(sheet, view, CHIP.corner)
    sheet.line(end, (end[0] - 40, 120), "thin")
    sheet.text((end[0] - 44, 114), "*t*_{max}: last revolution meets the stock", anchor="middle")
    some = np.deg2rad(13)
    start, end = thickness(sheet, view, some)
    sheet.line(start, (start[0] - 70, 318), "thin")
    sheet.text((start[0] - 74, 332), "*t*(*s*), normal to the edge", anchor="middle")
    # The engaged arc, from the last cusp to the stock.
    outside = view(*edge(np.linspace(CHIP.sweep[0], high, 121), inside=-0.035))
    for one, other in ((0, 4), (-1, -5)):
        way = np.array([outside[0][one] - outside[0][other], outside[1][one] - outside[1][other]])
        sheet.head((outside[0][one], outside[1][one]), way, "bad")
    sheet.path(outside, "wrongthin")
    at = 84
    sheet.line((outside[0][at], outside[1][at]), (150, 296), "wrongthin")
    sheet.text((146, 300), "engaged arc", ink="bad", anchor="end")

    sheet.arrow(view(0, 0.5), view(*edge(0.0)), "centre")
    sheet.text((tip[0] + 6, 90), "*R*, from the centre of the nose", ink="quiet", size="small")
    sheet.text((tip[0] - 40, 150), "edge now", ink="accent", anchor="middle")
    sheet.text((view(0.36, 0)[0], 150), "one revolution before", ink="accent", anchor="middle")
    sheet.arrow((210, 60), (120, 60), "outline")
    sheet.text((120, 52), "toward the axis", size="small", ink="quiet")
    sheet.text((568, 306), "finished surface", size="small")
    sizes = f"*R* = {CHIP.nose_radius:g} mm, *f* = {CHIP.feed:g} mm, *d* = {CHIP.depth:g} mm"
    note = f"To scale: {sizes}, *t*_{{max}} = {1e3 * CHIP.thickest:.0f} µm; real cuts are thinner by far."
    sheet.text((24, 362), note, size="small", ink="quiet")
    return sheet
