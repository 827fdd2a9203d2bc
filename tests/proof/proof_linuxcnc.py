"""LinuxCNC itself as a witness of `blend_blocks`: its commands to the servos, sampled in every servo cycle.

``python -m tests.proof.proof_linuxcnc [--user NAME] [--record FOLDER]`` plays programs on LinuxCNC without a display,
compares time and positions with the prediction, and fails where they differ. It needs the Debian package
``linuxcnc-uspace`` installed, and a user other than root (``--user`` names one if it is root who calls it). With
``--record`` it writes the samples of the short programs, which the suite reads.
"""

import argparse
import json
import os
import pwd
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import turnwright as tw
from turnwright.machine import blend_blocks

PERIOD = 1e-3
RECORD = struct.Struct("<I6d")
PINS = "ffffff"

INI = """[EMC]
VERSION = 1.1
[DISPLAY]
DISPLAY = ./player.py
[RS274NGC]
PARAMETER_FILE = sim.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 4.0
BASE_PERIOD = 0
SERVO_PERIOD = 1000000
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[HAL]
HALFILE = sim.hal
[TRAJ]
NO_FORCE_HOMING = 1
COORDINATES = X Z C
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_LINEAR_VELOCITY = {linear_speed}
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = sim.tbl
[KINS]
KINEMATICS = trivkins coordinates=XZC
JOINTS = 3
"""
AXIS = """[{head}]
MAX_VELOCITY = {speed}
MAX_ACCELERATION = {acceleration}
MIN_LIMIT = -1e9
MAX_LIMIT = 1e9
"""
JOINT = "TYPE = {kind}\nHOME = 0\nHOME_SEQUENCE = 0\nFERROR = 1e6\nMIN_FERROR = 1e6\n"
HAL = """loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
loadrt sampler depth=100000 cfg=ffffff
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf sampler.0 servo-thread
net est iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net change iocontrol.0.tool-change => iocontrol.0.tool-changed
"""
PLAYER = '''#!/usr/bin/python3
"""Stands for LinuxCNC's user interface: runs one program, and stores the samples of all cycles."""
import os
import struct
import sys
import time

import hal
import linuxcnc

folder = os.path.dirname(os.path.abspath(__file__))
component = hal.component("player%d" % os.getpid())
component.ready()
command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


def wait(condition, seconds, what):
    end = time.time() + seconds
    while time.time() < end:
        try:
            status.poll()
            if condition():
                return
        except linuxcnc.error:
            pass
        time.sleep(0.01)
    sys.exit(what)


wait(lambda: True, 20, "no status")
command.state(linuxcnc.STATE_ESTOP_RESET)
wait(lambda: status.task_state != linuxcnc.STATE_ESTOP, 10, "emergency stop")
command.state(linuxcnc.STATE_ON)
wait(lambda: status.task_state == linuxcnc.STATE_ON, 10, "not on")
command.mode(linuxcnc.MODE_AUTO)
wait(lambda: status.task_mode == linuxcnc.MODE_AUTO, 10, "not automatic")
command.program_open(os.path.join(folder, "program.ngc"))
command.wait_complete(5)
time.sleep(0.5)
stream = hal.stream(component, 0x48534130, "PINS")
while stream.read() is not None:
    pass
pack = struct.Struct("<I6d").pack
rows, last, lost = [], None, 0
command.auto(linuxcnc.AUTO_RUN, 0)
began, idle, end = False, 0, time.time() + LIMIT
while idle < 15:
    time.sleep(0.02)
    while (row := stream.read()) is not None:
        lost += last is not None and stream.sampleno != last + 1
        last = stream.sampleno
        rows.append(pack(last, *row))
    status.poll()
    if message := errors.poll():
        sys.exit(message[1])
    if status.interp_state != linuxcnc.INTERP_IDLE:
        began, idle = True, 0
    elif began:
        idle += status.queue == 0 and status.inpos
    if time.time() > end:
        sys.exit("time is over")
if lost:
    sys.exit("%d gaps in the samples" % lost)
with open(os.path.join(folder, "samples"), "wb") as file:
    file.write(b"".join(rows))
'''


def lathe(c, linear):
    """Return a lathe with LinuxCNC: acceleration of C [deg/s²], and of X and Z [mm/s²]."""
    slide = tw.Axis(speed=50.0, acceleration=linear)
    return tw.Machine(
        name="lathe with LinuxCNC", axes={"C": tw.Axis(acceleration=np.deg2rad(c)), "X": slide, "Z": slide},
        spindle_rpm=6000, block_rate_hz=1000, dialect="linuxcnc",
        controller=tw.Controller(interpolation="linuxcnc", variable_speed=True),
    )  # fmt: skip


def play(program, machine, user=None, limit=900):
    """Return what LinuxCNC commands in every cycle: X, Z and C of planner and servos. (n, 6) [mm and deg]."""
    folder = Path(tempfile.mkdtemp(prefix="linuxcnc-"))
    limits = {
        "C": (machine.spindle_rpm * 6, np.rad2deg(machine.axes["C"].acceleration)),
        **{letter: (machine.axes[letter].speed, machine.axes[letter].acceleration) for letter in "XZ"},
    }
    ini, hal = INI.format(linear_speed=limits["X"][0]), HAL
    for number, letter in enumerate("XZC"):
        speed, most = (repr(float(one)) for one in limits[letter])
        ini += AXIS.format(head=f"AXIS_{letter}", speed=speed, acceleration=most)
        ini += AXIS.format(head=f"JOINT_{number}", speed=speed, acceleration=most)
        ini += JOINT.format(kind="ANGULAR" if letter == "C" else "LINEAR")
        servo = f"joint.{number}.motor-pos-cmd => joint.{number}.motor-pos-fb sampler.0.pin.{number + 3}"
        hal += (
            f"net planned{letter} joint.{number}.coarse-pos-cmd => sampler.0.pin.{number}\nnet servo{letter} {servo}\n"
        )
    numbers = (*range(5161, 5170), *range(5181, 5190), *range(5210, 5391))
    files = {
        "sim.ini": ini, "sim.hal": hal, "sim.tbl": "", "program.ngc": Path(program).read_text(),
        "sim.var": "".join(f"{one}\t{float(one == 5220):.6f}\n" for one in numbers),
        "player.py": PLAYER.replace("PINS", PINS).replace("LIMIT", str(limit)),
    }  # fmt: skip
    for name, text in files.items():
        (folder / name).write_text(text)
    (folder / "player.py").chmod(0o755)
    home = pwd.getpwnam(user).pw_dir if user else os.environ["HOME"]
    words = ["linuxcnc", "-r", str(folder / "sim.ini")]
    if user:
        for one in (folder, *folder.iterdir()):
            shutil.chown(one, user)
        words = ["runuser", "-u", user, "--", "env", f"HOME={home}", f"USER={user}", "RUNTESTS=1", *words]
    # Without a display LinuxCNC writes its messages to text files.
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "PYTHONPATH")}
    done = subprocess.run(
        words,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=limit + 60,
        check=False,
    )
    samples = folder / "samples"
    if not samples.exists():
        raise RuntimeError(f"LinuxCNC did not play {program}: {(done.stdout + done.stderr).decode()[-2000:]}")
    rows = np.array([one[1:] for one in RECORD.iter_unpack(samples.read_bytes())])
    shutil.rmtree(folder)
    return rows


def cut_of(rows, motion, cycles):
    """Return the cycles of the cut among all samples, and how many more there are than predicted."""
    planned = np.stack([cycles.axes["X"], cycles.axes["Z"], np.rad2deg(cycles.axes["C"])], axis=1)
    start = np.flatnonzero((np.abs(rows[:, :3] - planned[0]) < 1e-8).all(axis=1))[-1]
    end = np.flatnonzero(np.abs(rows[:, 2] - np.rad2deg(motion.axes["C"][-1])) < 1e-9)[0]
    return rows[start : end + 1], planned, int(end - start) - (cycles.time.size - 1)


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
    parser.add_argument("--user")
    parser.add_argument("--record", type=Path)
    options = parser.parse_args()
    if shutil.which("linuxcnc") is None:
        print("LinuxCNC is not installed: nothing is played")
        return 0
    if os.geteuid() == 0 and options.user is None:
        print("LinuxCNC does not run as root: name a user with --user")
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
            rows = play(file, machine, options.user)
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
