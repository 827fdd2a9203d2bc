"""The pipeline: values in boxes, on each arrow the function that computes the next one."""

import itertools

from docs.drawings.sheet import SMALL, Sheet

WIDTH, HEIGHT = 80, 34
COLUMNS = 64, 213, 362, 511, 656
ABOVE, BELOW = 104, 330
RAILS = {"Part": 172, "Tool": 217, "Machine": 262}
PLANNING = (
    ("spiral", ("Part", "Tool")),
    ("place", ("Part", "Tool")),
    ("drive", ("Machine",)),
    ("write_nc", ("Machine",)),
)
SIMULATION = ("roughness", ()), ("minus", ("Part",)), ("generate", ("Tool", "Machine")), ("track", ("Machine",))


def value(sheet, x, y, name, pen="outline"):
    """Draw a value."""
    sheet.box((x - WIDTH / 2, y - HEIGHT / 2), (WIDTH, HEIGHT), pen, corner=4)
    sheet.text((x, y + 5), name, anchor="middle")


def feed(sheet, x, names, end):
    """Draw the arguments of a function: a dot on the line of each value, and an arrow to the function."""
    levels = [RAILS[name] for name in names]
    start = max(levels) if end < min(levels) else min(levels)
    sheet.arrow((x, start), (x, end), "thin")
    for level in levels:
        sheet.dot((x, level), "quiet")


def draw():
    """Return the drawing."""
    sheet = Sheet("The pipeline: from the prescription to the program, and to the surface that it leaves", height=412)
    sheet.text((24, 34), "Planning", size="head")
    sheet.text((24, 396), "Simulation, of any program", size="head")
    for name, y in RAILS.items():
        sheet.line((24 + WIDTH, y), (598, y), "faint")
        value(sheet, COLUMNS[0], y, name)
    for x, name in zip(COLUMNS, ("strategy", "Spiral", "Path", "Motion", "program"), strict=True):
        value(sheet, x, ABOVE, name, "tool" if name == "strategy" else "outline")
    for x, name in zip(COLUMNS, ("Sq, PV, …", "error", "HeightMap", "Motion", "Motion"), strict=True):
        value(sheet, x, BELOW, name)
    gaps = [(near_x + WIDTH / 2 + 2, far_x - WIDTH / 2 - 2) for near_x, far_x in itertools.pairwise(COLUMNS)]
    for (start, end), (plan, planned), (made, taken) in zip(gaps, PLANNING, SIMULATION, strict=True):
        middle = (start + end) / 2
        sheet.arrow((start, ABOVE), (end, ABOVE), "tool")
        sheet.text((middle, ABOVE - 9), plan, anchor="middle", ink="accent", size="small")
        feed(sheet, middle - 7, planned, ABOVE + 4)
        sheet.arrow((end, BELOW), (start, BELOW), "tool")
        sheet.text((middle, BELOW + SMALL + 7), made, anchor="middle", ink="accent", size="small")
        if taken:
            feed(sheet, middle + 7, taken, BELOW - 4)
    # The strategy says which axes move, too.
    turn = sum(gaps[2]) / 2
    sheet.path(([COLUMNS[0], COLUMNS[0], turn], [ABOVE - HEIGHT / 2, 60, 60]), "thin")
    sheet.arrow((turn, 60), (turn, ABOVE - 22), "thin")
    sheet.arrow((COLUMNS[-1], ABOVE + HEIGHT / 2 + 2), (COLUMNS[-1], BELOW - HEIGHT / 2 - 2), "tool")
    sheet.arrow((598, RAILS["Machine"]), (COLUMNS[-1] - 4, RAILS["Machine"]), "thin")
    sheet.text((COLUMNS[0], 135), "prescription", anchor="middle", size="small", ink="quiet")
    sheet.arrow((COLUMNS[0], 139), (COLUMNS[0], RAILS["Part"] - HEIGHT / 2 - 1), "thin")
    sheet.text((COLUMNS[-1] - 6, 222), "read_nc", anchor="end", ink="accent", size="small")
    sheet.text((COLUMNS[2], BELOW + 36), "surface left", anchor="middle", size="small", ink="quiet")
    sheet.text((COLUMNS[1], BELOW + 36), "cut − design", anchor="middle", size="small", ink="quiet")
    sheet.text((COLUMNS[3], BELOW + 36), "real axes", anchor="middle", size="small", ink="quiet")
    sheet.text((COLUMNS[4], BELOW + 36), "commanded", anchor="middle", size="small", ink="quiet")
    return sheet
