"""Cusps of a round nose on a flat, cut by the simulator."""

import numpy as np

import turnwright as tw
from docs.drawings.sheet import Sheet, View

FEED, NOSE = 0.010, 0.5
TOOL = tw.Tool(nose_radius=NOSE, included=np.deg2rad(60))


def cut():
    """Return tips at azimuth 0 [mm], and the profile that they leave there, (radius, height) [mm]."""
    part = tw.Part(surface=tw.Plane(), radius=0.08)
    servo = tw.SlowToolServo(feed=FEED, points_per_rev=24, spindle_rpm=60, lead_in=0.02)
    motion = tw.drive(tw.place(servo.spiral(part, TOOL), part, TOOL), servo, tw.Machine.load("generic"))
    turns = np.isclose(np.cos(motion.axes["C"]), 1.0)
    radius = np.linspace(0.0405, 0.0795, 1561)
    return motion.axes["X"][turns], (radius, tw.generate_polar(motion, TOOL, radius=radius, angle=[0.0]).z[0])


def draw():
    """Return the drawing."""
    tips, (radius, height) = cut()
    pv = float(np.ptp(height))
    view = View(-480, 236, 13600, 100 / pv)
    sheet = Sheet("Cusp and feed", height=330)
    first_x, last_x = view(radius[0], 0)[0], view(radius[-1], 0)[0]
    profile = view(radius, height)
    sheet.material(
        tuple(np.append(one, more) for one, more in zip(profile, ([last_x, first_x], [276, 276]), strict=True))
    )

    shown = np.sort(tips[(tips > radius[0] - FEED / 2) & (tips < radius[-1] + FEED / 2)])
    reach = np.linspace(-1.2 * FEED, 1.2 * FEED, 121)
    with sheet.inside((first_x, 20), (last_x - first_x, 260)):
        for tip in shown:
            sheet.path(view(tip + reach, NOSE - np.sqrt(NOSE**2 - reach**2)), "toolthin")
        nose = view(shown[1] + reach, NOSE - np.sqrt(NOSE**2 - reach**2))
        sheet.path(nose, "diamond none", close=True)
    sheet.path(profile, "outline")
    crest, valley = view(shown[1] + FEED / 2, pv), view(shown[2], 0)
    sheet.text((view(shown[1], 0)[0], 96), "nose, radius *R*", ink="accent", anchor="middle")
    for tip in shown[1:3]:
        sheet.dot(view(tip, 0))
    at = view(shown[1], 0), valley
    sheet.dimension((at[0][0], 258), (at[1][0], 258), "feed *f*", reach=at, text=((at[0][0] + at[1][0]) / 2, 276))
    far = view(shown[3], 0)[0] - 22
    sheet.dimension((far, valley[1]), (far, crest[1]), "PV", reach=(valley, crest), text=(far - 8, 196), anchor="end")
    # Mean of a parabola from valley to crest, and its deviation.
    for level, pen in ((1 / 3, "centre"), (1 / 3 + np.sqrt(4 / 45), "dashed"), (1 / 3 - np.sqrt(4 / 45), "dashed")):
        y = 236 - 100 * level
        sheet.line((first_x, y), (last_x, y), pen)
    sheet.text((first_x - 6, 207), "mean", anchor="end", size="small", ink="quiet")
    sheet.text((first_x - 6, 177), "+Sq", anchor="end", size="small", ink="quiet")
    sheet.text((first_x - 6, 237), "−Sq", anchor="end", size="small", ink="quiet")
    sheet.arrow((660, 44), (590, 44), "outline")
    sheet.text((668, 36), "toward the axis", anchor="end", size="small", ink="quiet")
    sheet.text((24, 306), f"*f* = {1e3 * FEED:g} µm, *R* = {NOSE:g} mm: PV = {1e6 * pv:.1f} nm, "
               f"Sq = {1e6 * pv * np.sqrt(4 / 45):.2f} nm.  "
               f"Heights {(100 / pv) / 13600:.0f} times enlarged.", ink="quiet", size="small")  # fmt: skip
    return sheet
