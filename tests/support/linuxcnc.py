"""LinuxCNC's interpreter as a witness: what it makes of a program, in a process of the system's Python.

The Debian package ``linuxcnc-uspace`` need not be installed: ``tools/unpack_linuxcnc FOLDER`` unpacks it, and
``TURNWRIGHT_LINUXCNC`` names the folder.
"""

import os
import subprocess
from functools import cache
from pathlib import Path

import numpy as np

PYTHON = Path("/usr/bin/python3")
INCH = 25.4
"""The interpreter's unit of length. [mm]"""
TOOLS = 99
"""Tools of the table, all of length 0."""

SCRIPT = """
import array
import ctypes
import sys
import gcode

# The table of tools is in memory that LinuxCNC shares among its processes, in a file of the home folder.
tools = ctypes.CDLL("libtooldata.so.0")
tools._Z17tool_mmap_creatorPK13EMC_TOOL_STATi(ctypes.create_string_buffer(1 << 20), 0)
tools._Z13tooldata_initb(False)
tools._Z13tooldata_loadPKcPPc(sys.argv[4].encode(), None)

class Canon:
    parameter_file = sys.argv[2]

    def __init__(self):
        self.feed, self.rows, self.mark = 0.0, [], 0

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *_: None

    def get_external_angular_units(self): return 1.0
    def get_external_length_units(self): return 1.0
    def get_axis_mask(self): return 1 + 2 + 4 + 32
    def get_block_delete(self): return 0
    def get_tool(self, index): return (index or -1,) + (0.0,) * 12 + (0,)
    def check_abort(self): return False
    def set_feed_rate(self, value): self.feed = value
    def comment(self, text):
        if text.strip().startswith(("PASS:", "interpreter: feed mode")):
            self.mark += 1
            print(text.strip(), file=sys.stderr)

    def straight_traverse(self, *to): self.add(0, to)
    def straight_feed(self, *to): self.add(1, to)

    def add(self, kind, to):
        self.rows.append((self.mark, kind, to[0], to[1], to[2], to[5], self.feed))

canon = Canon()
result, line = gcode.parse(sys.argv[1], canon, "G21", "")
if result > gcode.MIN_ERROR:
    sys.exit(f"line {line}: {gcode.strerror(result)}")
with open(sys.argv[3], "wb") as file:
    array.array("d", [number for row in canon.rows for number in row]).tofile(file)
"""


@cache
def environment():
    """The environment of a process with the module ``gcode``, or ``None``."""
    folder = os.environ.get("TURNWRIGHT_LINUXCNC")
    root = Path(folder) if folder else Path("/")
    packages = root / "usr/lib/python3/dist-packages"
    libraries = f"{root}/usr/lib:{root}/usr/lib/x86_64-linux-gnu"
    found = {**os.environ, "PYTHONPATH": str(packages), "LD_LIBRARY_PATH": libraries}
    if not PYTHON.exists():
        return None
    done = subprocess.run([PYTHON, "-c", "import gcode"], env=found, capture_output=True, check=False)
    return found if done.returncode == 0 else None


def interpret(program, folder):
    """Return the cuts of a program by pass: X, Y, Z [mm], C [deg] and time [s] of their points, the first as it begins.

    A cut is a run of blocks under G93, or one under G94 or G95 of which each moves X; under G95 a revolution counts as
    a minute.
    """
    parameters, out = folder / "parameters.var", folder / "moves.bin"
    numbers = {*range(5161, 5170), *range(5181, 5190), *range(5210, 5391)}
    parameters.write_text("".join(f"{n}\t{1.0 if n == 5220 else 0.0}\n" for n in sorted(numbers)))
    tools = folder / "tools.tbl"
    tools.write_text("".join(f"T{n} P{n} Z0 D1\n" for n in range(1, TOOLS + 1)))
    done = subprocess.run(
        [PYTHON, "-c", SCRIPT, program, parameters, out, tools], env={**environment(), "HOME": str(folder)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"exit code {done.returncode}: {done.stderr[-500:]}"
    marks = ["", *(line for line in done.stderr.splitlines() if line.startswith(("PASS:", "interpreter:")))]
    moves = np.fromfile(out).reshape(-1, 7)
    name, cuts = "", {}
    for number, text in enumerate(marks):
        name = text.removeprefix("PASS:").strip() if text.startswith("PASS:") else name
        at = np.flatnonzero((moves[:, 0] == number) & (moves[:, 1] == 1))
        if not at.size or name.endswith(", ENTRY"):
            continue
        if "inverse time" in text or (moves[at, 2] != moves[at - 1, 2]).all():
            cuts[name] = _cut(moves[at[0] - 1 : at[-1] + 1])
    return cuts


def _cut(rows):
    place = rows[:, 2:5] * INCH
    length = np.linalg.norm(np.diff(rows[:, 2:5], axis=0), axis=1)
    # A feed of C alone is in deg, but given like one in mm.
    length = np.where(length > 0, length, np.abs(np.diff(rows[:, 5])) / INCH)
    time = np.concatenate(([0.0], np.cumsum(60 * length / rows[1:, 6])))
    return *place.T, rows[:, 5], time
