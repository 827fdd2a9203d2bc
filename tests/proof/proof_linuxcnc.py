"""LinuxCNC itself as a witness of `blend_blocks`: its commands to the servos, sampled in every servo cycle.

``python -m tests.proof.proof_linuxcnc [--record FOLDER]`` plays programs on LinuxCNC without a display,
compares time and positions with the prediction, and fails where they differ, see `linuxcnc_planner`. With ``--record``
it writes the samples of the short programs, which the suite reads.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np

import turnwright as tw
from tests.support.linuxcnc_planner import PERIOD, cut_of, lathe, play, player
from turnwright.machine import blend_blocks


def freeform(feed, points, rpm, machine, reach, sense=1):
    """Return the motion of a cut without symmetry."""
    surface = tw.SineGrid(amplitude=(0.002, 0.002), period=(2.5, 2.5)) + tw.XYPolynomial(
        terms={(1, 0): 1e-3, (1, 2): 5e-4}
    )
    part, tool = tw.Part(surface=surface, radius=reach), tw.Tool(nose_radius=0.514, included=np.deg2rad(60))
    servo = tw.SlowToolServo(feed=feed, points_per_rev=points, spindle_rpm=rpm, lead_in=0.028, sense=sense)
    return tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, machine)


CASES = {
    # Li's grid: feed 50 um, 360 points a turn, 120 rev/min, as far as 1.25 mm.
    "slow C": ((0.05, 360, 120, 1.25), (2e5, 5000)),
    "fast C": ((0.05, 360, 120, 1.25), (2e7, 50000)),
    "few points": ((0.1, 36, 30, 1.0), (2e5, 5000)),
    "uneven points": ((0.2, 120, 90, 1.0, -1), (1e6, 2000)),
    "short, slow C": ((0.25, 90, 113, 1.0), (1.3e5, 3000)),
    "short, fast C": ((0.5, 120, 97, 1.0, -1), (5e6, 9000)),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--record", type=Path)
    options = parser.parse_args()
    user = player()
    if user is None:
        print("LinuxCNC cannot be run: install it, and name a user in TURNWRIGHT_LINUXCNC_USER if you are root")
        return 0
    failed = False
    print("case             blocks  stated    promised  played     planner's X, Z, C off       Z over C off")
    for name, (how, limits) in CASES.items():
        machine = lathe(*limits)
        motion = freeform(*how[:3], machine, *how[3:])
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "part.nc"
            tw.write_nc(motion, machine, file, depth=None)
            again, text = tw.read_nc(file, machine), file.read_text()
            rows = play(file, machine, user)
        promised = tw.check_limits(again, machine).cycle_time_s
        played, planned, more = cut_of(rows, again, blend_blocks(again.time, again.axes, machine))
        count = min(len(played), len(planned))
        off = np.abs(played[:count, :3] - planned[:count]).max(axis=0)
        track = tw.track(again)
        between = slice(20, count - 20)
        c = np.deg2rad(played[between, 5]) * again.sense
        over = played[between, 4] - np.interp(c, track.axes["C"] * again.sense, track.axes["Z"])
        turns = (again.axes["C"][-1] - again.axes["C"][0]) * again.sense / 2 / np.pi
        print(
            f"{name:16} {again.time.size - 1:6} {turns * 60 / how[2]:8.3f} s {promised:8.3f} s "
            f"{(len(played) - 1) * PERIOD:8.3f} s  {off[0]:.1e} {off[1]:.1e} mm {off[2]:.1e} deg  "
            f"{over.std() * 1e6:.1e} nm rms"
        )
        failed |= more != 0 or bool(off.max() > 1e-9) or over.std() > 1e-6
        if options.record and name.startswith("short"):
            settings = {"c": limits[0], "linear": limits[1], "sense": again.sense}
            np.savez_compressed(
                options.record / f"{name.replace(', ', '_').replace(' ', '_')}.npz", rows=played, program=text,
                settings=json.dumps(settings),
            )  # fmt: skip
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
