"""LinuxCNC's planner as a witness: what it commands in every servo cycle of a program, without a display.

It needs the Debian package ``linuxcnc-uspace`` installed, and a user other than root, whom ``TURNWRIGHT_LINUXCNC_USER``
names where root runs the tests.
"""

import os
import pwd
import shutil
import struct
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import turnwright as tw

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
    planned = np.stack([cycles.positions("X"), cycles.positions("Z"), np.rad2deg(cycles.positions("C"))], axis=1)
    start = np.flatnonzero((np.abs(rows[:, :3] - planned[0]) < 1e-8).all(axis=1))[-1]
    end = np.flatnonzero(np.abs(rows[:, 2] - np.rad2deg(motion.axes["C"][-1])) < 1e-9)[0]
    return rows[start : end + 1], planned, int(end - start) - (cycles.time.size - 1)


def player():
    """Return the user who plays programs, "" for this one, or None if LinuxCNC cannot be run."""
    if shutil.which("linuxcnc") is None:
        return None
    if os.geteuid() != 0:
        return ""
    return os.environ.get("TURNWRIGHT_LINUXCNC_USER")
