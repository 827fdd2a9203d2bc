"""The loop: from a job to a part, its measurement, and a better job."""

from docs.drawings.sheet import Sheet

WIDTH, HEIGHT = 116, 52
COLUMNS = 82, 268, 454, 638
ABOVE, BELOW = 70, 214


def value(sheet, x, y, name, note, pen="outline"):
    """Draw a value, with what it holds."""
    sheet.box((x - WIDTH / 2, y - HEIGHT / 2), (WIDTH, HEIGHT), pen, corner=4)
    sheet.text((x, y - 3), name, anchor="middle")
    sheet.text((x, y + 15), note, anchor="middle", size="small", ink="quiet")


def draw():
    """Return the drawing."""
    sheet = Sheet("The loop: job, cut, measure, register, diagnose, correct, better job", height=316)
    half, high = WIDTH / 2 + 3, HEIGHT / 2 + 3
    value(sheet, COLUMNS[0], ABOVE, "Job", "part, tool, lathe", "tool")
    value(sheet, COLUMNS[1], ABOVE, "program", "proved first")
    value(sheet, COLUMNS[2], ABOVE, "part", "as cut")
    value(sheet, COLUMNS[3], ABOVE, "HeightMap", "as measured")
    value(sheet, COLUMNS[3], BELOW, "form error", "and the pose")
    value(sheet, COLUMNS[2], BELOW, "Diagnosis", "sources, field")
    value(sheet, COLUMNS[1], BELOW, "does it help?", "200 draws")
    value(sheet, COLUMNS[0], BELOW, "better Job", "inputs corrected", "tool")
    for near_x, far_x, word in zip(COLUMNS, COLUMNS[1:], ("run", "cut", "measure"), strict=False):
        sheet.arrow((near_x + half, ABOVE), (far_x - half, ABOVE), "tool")
        sheet.text(((near_x + far_x) / 2, ABOVE - 9), word, anchor="middle", ink="accent", size="small")
    for near_x, far_x, word in zip(COLUMNS, COLUMNS[1:], ("yes", "correct", "diagnose"), strict=False):
        sheet.arrow((far_x - half, BELOW), (near_x + half, BELOW), "tool")
        ink = "good" if word == "yes" else "accent"
        sheet.text(((near_x + far_x) / 2, BELOW - 9), word, anchor="middle", ink=ink, size="small")
    sheet.arrow((COLUMNS[3], ABOVE + high), (COLUMNS[3], BELOW - high), "tool")
    sheet.text((COLUMNS[3] - 8, 146), "register", anchor="end", ink="accent", size="small")
    sheet.arrow((COLUMNS[0], BELOW - high), (COLUMNS[0], ABOVE + high), "tool")
    sheet.text((COLUMNS[0] + 8, 146), "cut again", ink="accent", size="small")
    sheet.arrow((COLUMNS[1], BELOW + high), (COLUMNS[1], BELOW + high + 32), "wrong")
    sheet.text((COLUMNS[1] + 10, BELOW + high + 20), "no", ink="bad", size="small")
    sheet.text(
        (COLUMNS[1], BELOW + high + 50), "nothing is written, exit code 3", anchor="middle", ink="bad", size="small"
    )
    return sheet
