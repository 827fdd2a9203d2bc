"""Wrong jobs: exit code 2, one sentence that says what is wrong, and no output left."""

import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import turnwright
from job_files import GONE, changed, written
from patience import PATIENCE_S
from turnwright.cli import main
from turnwright.errors import JobError
from turnwright.job import Job

LENS = Path(__file__).parents[2] / "examples" / "infrared_lens.toml"
GRID = {"family": "gridded", "file": "sag.csv", "units": "mm", "sag_units": "um"}
EXPRESSION = {"family": "expression", "units": "mm", "formula": "x**2/100"}
DEEP = {"family": "sine grid", "amplitude": ["50 um", "0 um"], "period": ["1 mm", "1 mm"]}
HEXAGONS = {"family": "lens array", "layout": "hexagonal", "pitch": "0.5 mm", "rings": 2,
            "lenslet": {"family": "sphere", "radius": "-5 mm"}}  # fmt: skip
PATCH = "simulation.patches.0"

# What is changed, and what the sentence must say.
# ruff: noqa: E501 - a table
WRONG = {
    "a length in degrees": ([("part.radius", "1 deg")], r"part\.radius: '1 deg' is an angle, it must be a length"),
    "a length without a unit": ([("part.radius", 1)], r"part\.radius: 1 has no unit"),
    "a decimal comma": ([("tool.nose_radius", "0,5 mm")], r"tool\.nose_radius: '0,5 mm' does not start with a plain"),
    "two numbers": ([("tool.nose_radius", "2 mm 3")], r"tool\.nose_radius: '2 mm 3' has '3' after its unit"),
    "a length of nan": ([("tool.nose_radius", "nan mm")], r"tool\.nose_radius: 'nan mm' does not start"),
    "a bare nan": ([("tool.nose_radius", float("nan"))], r"tool\.nose_radius: nan has no unit"),
    "a length beyond numbers": ([("tool.nose_radius", "1e400 mm")], r"'1e400 mm' is beyond the range of numbers"),
    "a feed per turn of angle": ([("strategy.feed", "2 um/turn")], r"strategy\.feed: '2 um/turn' is a length per angle"),
    "a feed in mm/min": ([("strategy.feed", "2 mm/min")], r"strategy\.feed: '2 mm/min' is a speed, it must be a feed"),
    "a negative feed": ([("strategy.feed", "-8 um/rev")], r"strategy\.feed: '-8 um/rev' is not above 0"),
    "a feed of zero": ([("strategy.feed", "0 um/rev")], r"strategy\.feed: '0 um/rev' is not above 0"),
    "no feed": ([("strategy.feed", GONE)], r"strategy\.feed is missing and has no default"),
    "no tool": ([("tool", GONE)], r"tool is missing"),
    "no nose radius": ([("tool.nose_radius", GONE)], r"tool\.nose_radius is missing"),
    "an unknown key": ([("part.raduis", "1 mm")], r"part\.raduis is not a known key: did you mean 'radius'\?"),
    "an unknown table": ([("toool", {})], r"toool is not a known key: did you mean 'tool'\?"),
    "an unknown family": ([("part.surface.family", "sfere")], r"part\.surface has the family 'sfere'.*'sphere'"),
    "no family": ([("part.surface", {"radius": "5 mm"})], r"part\.surface lacks the key family"),
    "an unknown machine": ([("machine.name", "lathe")], r"machine: machine file 'lathe' cannot be read.*generic"),
    "a missing machine file": (
        [("machine", {"file": "none.toml"})],
        r"machine\.file: the file 'none\.toml' does not exist",
    ),
    "a machine named twice": ([("machine.file", "job.toml")], r"machine: the machine needs either name or file"),
    "an unknown dialect": ([("machine.dialect", "klingon")], r"dialect 'klingon'"),
    "a missing sag table": ([("part.surface", GRID | {"file": "none.csv"})], r"part\.surface\.file: .*does not exist"),
    "nan in a sag table": ([("part.surface", GRID | {"file": "nan.csv"})], r"has no height at 1 points on or next to it"),
    "words in a sag table": ([("part.surface", GRID | {"file": "words.csv"})], r"words\.csv has no table of numbers"),
    "an aperture larger than the grid": (
        [("part.surface", GRID), ("part.radius", "3 mm")],
        r"clear aperture is 3 mm but Gridded is not defined beyond",
    ),
    "an aperture outside the conic": ([("part.radius", "60 mm")], r"Sphere is not defined beyond about 50 mm.* disc of radius 50 mm"),
    "a formula that is a program": (
        [("part.surface", EXPRESSION | {"formula": "__import__('os')"})],
        r"part\.surface: formula \"__import__",
    ),
    "a formula without its units": (
        [("part.surface", {"family": "expression", "formula": "x"})],
        r"part\.surface\.units is missing",
    ),
    "a coefficient without a unit": (
        [("part.surface", {"family": "xy polynomial", "terms": {"2,0": 0.01}})],
        r"part\.surface\.terms\.2,0: 0\.01 has no unit",
    ),
    "a coefficient of the wrong power": (
        [("part.surface", {"family": "xy polynomial", "terms": {"2,0": "0.01 1/mm^2"}})],
        r"'0\.01 1/mm\^2' is a number per length\^2, it must be a number per length",
    ),
    "a Zernike index of words": (
        [("part.surface", {"family": "zernike", "radius": "1 mm", "indexing": "noll", "terms": {"z": "1 um"}})],
        r"the key 'z' is not a whole number",
    ),
    "a tool too large for a trough": (
        [("part.surface", DEEP), ("tool.nose_radius", "5 mm"), ("tool.clearance", "40 deg")],
        r"nose_radius is 5 mm, the limit is 0\.5\d+ mm",
    ),
    "a clearance that is too small": (
        [("part.surface", DEEP), ("tool.clearance", "2 deg")],
        r"clearance needs to be 17\.\d deg .* the tool has 2 deg",
    ),
    "a sharp valley not accepted": ([("part.surface", HEXAGONS)], r"the slope changes by .* in a sharp valley"),
    "an included angle beyond half a turn": ([("tool.included", "200 deg")], r"included is 3.49066 rad .200 deg."),
    "waviness in one unit": ([("tool.waviness", ["1 nm/deg", "1 nm/deg"])], r"tool\.waviness\[2\]: '1 nm/deg' is a leng"),
    "two offsets": ([("tool.offset", ["1 um", "2 um"])], r"tool\.offset\[3\] is missing"),
    "a certificate without units": ([("tool.waviness_file", "certificate.csv")], r"has no column 'sweep' in its first"),
    "a feed wider than the nose": ([("strategy.feed", "2 mm/rev")], r"feed 2 mm per rev is at least the width of the"),
    "points set twice": ([("strategy.chord", "5 nm")], r"set by points_per_rev and chord: give exactly one"),
    "points not set": ([("strategy.points_per_rev", GONE)], r"set by nothing: give exactly one"),
    "points in quotes": ([("strategy.points_per_rev", "120")], r"points_per_rev is '120', it must be a whole number"),
    "a sense of 2": ([("strategy.sense", 2)], r"strategy\.sense is 2, it must be 1 or -1"),
    "a spindle faster than the lathe": ([("strategy.spindle_speed", "1e6 rpm")], r"spindle|rev/min"),
    "more blocks than the controller takes": ([("strategy.spindle_speed", "490 rpm"), ("strategy.points_per_rev", 720)], r"accept = \[\"limits\"\]"),
    "a sum of nothing": ([("part.surface", [])], r"part\.surface: .*sum"),
    "nothing free": ([("measurement.free", [])], r"measurement: free needs at least 1"),
    "no error source": ([("measurement.error_sources", [])], r"measurement: error_sources needs at least 1"),
    "no wave": ([("measurement.waviness", [])], r"measurement: waviness needs at least 1"),
    "no pass": ([("passes", [])], r"passes needs at least 1"),
    "a pass that leaves stock": (
        [("part.stock", "10 um"), ("passes", [{"name": "rough", "allowance": "5 um"}])],
        r"last pass must be 0 mm, got 0\.005 mm",
    ),
    "a pass above the stock": ([("passes", [{"name": "a", "allowance": "5 um"}])], r"passes\[1\]\.allowance is 0\.005 mm"),
    "two passes of one name": ([("passes", [{"name": "a"}, {"name": "a"}])], r"names in passes .* 'a' occurs 2 times"),
    "a name that a repetition takes": (
        [("part.stock", "20 um"), ("passes", [{"name": "rough", "allowance": "5 um", "depth": "8 um"}, {"name": "Rough-1"}])],
        r"names in passes .* 'rough 1' occurs 2 times",
    ),
    "two names that differ in case": ([("passes", [{"name": "a"}, {"name": "A"}])], r"names in passes .* 'a' occurs 2 times"),
    "one coefficient written twice": (
        [("part.surface", {"family": "xy polynomial", "units": "mm", "terms": {"2,0": 0.01, "02,0": 0.02}})],
        r"the key '02,0' means the same as '2,0': remove one",
    ),
    "one power written twice": (
        [("part.surface", {"family": "even asphere", "radius": "50 mm", "conic": 0, "units": "mm", "terms": {"4": 1e-6, "04": 1e-6}})],
        r"the key '04' means the same as '4': remove one",
    ),
    "a degree beyond all series": (
        [("part.surface", {"family": "xy polynomial", "units": "mm", "terms": {"2000,0": 1}})],
        r"part\.surface\.terms\.2000,0: its unit is mm\^-1999, the limit is mm\^-99",
    ),
    "a power of thousands of digits": (
        [("part.surface", {"family": "even asphere", "radius": "50 mm", "conic": 0, "units": "mm", "terms": {"4" * 5000: 1}})],
        r"is not a whole number",
    ),
    "points beyond numbers": ([("strategy.points_per_rev", 10**400)], r"points_per_rev is 1000.*, it must be at most 1000000000"),
    "a certificate that is no text": ([("tool.waviness_file", "utf16.csv")], r"utf16\.csv is not a CSV table in UTF-8 .*: save it as plain text"),
    "a certificate of one endless cell": ([("tool.waviness_file", "cell.csv")], r"cell\.csv is not a CSV table in UTF-8 .*: save it"),
    "a machine sign that is no sign": ([("machine", {"file": "sign.toml"})], r"x_side is -1\.0, it must be a whole number"),
    "a machine sign that is a yes": ([("machine", {"file": "yes.toml"})], r"x_side is True, it must be a whole number"),
    "a machine faster than numbers": ([("machine", {"file": "fast.toml"})], r"spindle_rpm is beyond the range of numbers"),
    "a machine that is no TOML": ([("machine", {"file": "broken.toml"})], r"broken\.toml' is not TOML, .*: correct that line"),
    "a machine too deep to read": ([("machine", {"file": "deep.toml"})], r"deep\.toml' nests lists or tables too deeply"),
    "a pass named for a folder": ([("passes", [{"name": "../a"}])], r"passes\[1\]\.name is '\.\./a'"),
    "a depth that is a slip": (
        [("part.stock", "1 mm"), ("passes", [{"name": "a", "depth": "1 nm"}])],
        r"the pass repeats 1000000 times, the limit is 100",
    ),
    "a patch outside the part": ([(PATCH + ".centre", ["1 mm", "0 mm"])], r"patches\[1\] extends 1\.10454 mm"),
    "a patch of too many points": ([(PATCH + ".pixel", "1 nm"), (PATCH + ".size", ["1 mm", "1 mm"])], r"limit is 1e\+08"),
    "a pixel larger than its patch": ([(PATCH + ".pixel", "1 mm")], r"pixel must be at most"),
    "a map of too many points": (
        [("simulation.whole_part", {"radii": 100000, "angles": 10000})],
        r"whole_part: radii times angles is 1000000000, the limit is 1e\+08",
    ),
    "a blank of a slip": (
        [("part.surface", {"family": "sphere", "radius": "20 mm"}), ("part.blank", {"radius": "1e9 mm"})],
        r"blank of radius 1e\+09 mm .*, the limit is 1000 mm: correct part\.blank\.radius",
    ),
    "a device for a machine": ([("machine", {"file": "/dev/zero"})], r"machine\.file: '/dev/zero' must be a file"),
    "a map of one radius": ([("simulation.whole_part.radii", 1)], r"whole_part\.radii is 1, it must be at least 2"),
    "half a radius": ([("simulation.whole_part.radii", 40.5)], r"radii is 40\.5, it must be a whole number"),
    "three coordinates": (
        [(PATCH + ".centre", ["0 mm", "0 mm", "0 mm"])],
        r"patches\[1\]\.centre has 3 values, the limit is 2",
    ),
    "a length for a table": ([("tool", "0.5 mm")], r"tool is '0\.5 mm', it must be a table"),
    "a number for terms": (
        [("part.surface", {"family": "xy polynomial", "terms": 5})],
        r"part\.surface\.terms is 5, it must be a table",
    ),
    "a word for a number": (
        [("part.surface", {"family": "conic", "radius": "5 mm", "conic": "-1"})],
        r"part\.surface\.conic is '-1', it must be a plain number",
    ),
    "an infinite conic": (
        [("part.surface", {"family": "conic", "radius": "5 mm", "conic": float("inf")})],
        r"part\.surface\.conic is infinite, it must be a finite number",
    ),
    "a number for a name": ([("part.name", 5)], r"part\.name is 5, it must be text in quotes"),
    "a word for yes": ([("strategy.inside_out", "yes")], r"strategy\.inside_out is 'yes', it must be true or false"),
    "units of a formula that are none": (
        [("part.surface", {"family": "xy polynomial", "units": "deg", "terms": {"2,0": 1}})],
        r"part\.surface\.units: '1 deg' is an angle, it must be a length",
    ),
    "an unknown form": ([("roughness.form", "round")], r"roughness\.form: .* got 'round'"),
    "something accepted that is nothing": ([("accept", ["all"])], r"accept\[1\] is 'all', it must be"),
    "an actual tool without a nose": ([("actual.tool.radius_error", "-1 mm")], r"no nose remains"),
}  # fmt: skip


@pytest.fixture
def place(tmp_path):
    """A folder with the files that wrong jobs name."""
    folder = tmp_path / "jobs"
    folder.mkdir()
    nodes = [-2, -1.2, -0.4, 0.4, 1.2, 2]
    rows = [[y, *(x * x + y * y for x in nodes)] for y in nodes]

    def table(rows):
        return "\n".join(",".join(map(str, row)) for row in [["", *nodes], *rows])

    (folder / "sag.csv").write_text(table(rows))
    (folder / "nan.csv").write_text(table([*rows[:2], [*rows[2][:3], "nan", *rows[2][4:]], *rows[3:]]))
    (folder / "words.csv").write_text("x,y,z\none,two,three\n")
    (folder / "certificate.csv").write_text("sweep,deviation\n0,0\n1,1\n")
    (folder / "utf16.csv").write_text("sweep [deg],deviation [nm]\n0,0\n", encoding="utf-16")
    (folder / "cell.csv").write_text("sweep [deg],deviation [nm]\n0," + "1" * 200_000)
    generic = (Path(turnwright.__file__).parent / "machines" / "generic.toml").read_text(encoding="utf-8")
    (folder / "sign.toml").write_text(generic + "\n[convention]\nx_side = -1.0\n")
    (folder / "yes.toml").write_text(generic + "\n[convention]\nx_side = true\n")
    (folder / "fast.toml").write_text(re.sub("(?m)^spindle_rpm = [0-9].*$", "spindle_rpm = 1" + "0" * 400, generic))
    (folder / "broken.toml").write_text("[axes\n")
    (folder / "deep.toml").write_text("a = " + "[" * 5000)
    return folder


def refused(folder, job, capsys, *options):
    """Run a job that must be refused; return its one sentence."""
    before = {entry: entry.stat().st_mtime_ns for entry in folder.rglob("*")}
    assert main(["run", str(job), "--out", str(folder / "out"), *options]) == 2
    assert {entry: entry.stat().st_mtime_ns for entry in folder.rglob("*")} == before  # nothing half-written
    message = [line for line in capsys.readouterr().err.splitlines() if line.startswith("turnwright: ")]
    assert len(message) == 1
    return message[0]


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_job_is_refused_in_one_sentence(name, place, capsys):
    changes, sentence = WRONG[name]
    message = refused(place, written(place, *changes), capsys)
    assert re.search(sentence, message), message
    assert re.search(r"[:?]", message.removeprefix("turnwright: "))  # what is wrong, then the remedy


def test_all_wrong_fields_are_reported_at_once():
    with pytest.raises(JobError) as caught:
        Job.read(changed(("part.radius", 1), ("tool.nose_radius", GONE), ("strategy.sense", 0)))
    assert [line.split()[0].rstrip(":") for line in str(caught.value).splitlines()] == [
        "part.radius", "tool.nose_radius", "strategy.sense"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, r"cannot be read \(No such file or directory\)"),
        (b"[part\n", r"is not TOML, .*line 1"),
        (b"\xff\xfe\x00", r"is not UTF-8 text"),
        (b'[part]\nname = "a"\nname = "b"\n', r"is not TOML, a key is given twice \(at line 3, .*\)"),
        (b"[part]\n[tool]\n[part]\n", r"is not TOML, a table is given twice \(at line 3, .*\)"),
        (b"a = " + b"1" * 5000, r"holds a whole number of thousands of digits: shorten it"),
        (b"a = " + b"[" * 5000, r"nests lists or tables too deeply"),
        (b"", r"part is missing"),
    ],
)
def test_a_file_that_is_no_job_is_refused(content, sentence, tmp_path, capsys):
    job = tmp_path / "job.toml"
    if content is not None:
        job.write_bytes(content)
    if content == b"":
        assert main(["check", str(job)]) == 2
        assert re.search(sentence, capsys.readouterr().err)
    else:
        assert re.search(sentence, refused(tmp_path, job, capsys))


def test_a_byte_order_mark_is_no_mistake(place):
    """Windows editors write one; oracle: the same job without."""
    job = written(place)
    generic = (Path(turnwright.__file__).parent / "machines" / "generic.toml").read_bytes()
    (place / "marked.toml").write_bytes(b"\xef\xbb\xbf" + generic)
    plain = Job.load(job)
    job.write_bytes(b"\xef\xbb\xbf" + job.read_bytes())
    assert Job.load(job) == plain
    marked = turnwright.Machine.load(place / "marked.toml")
    assert marked.spindle_rpm == plain.machine.spindle_rpm


def test_units_of_no_terms_are_read_too(tmp_path):
    """Oracle: what a job says is read back to an equal job."""
    none = {"family": "zernike", "radius": "1 mm", "indexing": "noll", "units": "um", "terms": {}}
    job = Job.read(changed(("part.surface", [{"family": "plane"}, none])))
    (tmp_path / "again.toml").write_text(job.to_toml())
    assert Job.load(tmp_path / "again.toml") == job
    assert job.part.surface.terms[1].terms == ()


def test_a_taken_folder_is_not_touched(place, capsys):
    job = written(place)
    (place / "out").mkdir()
    (place / "out" / "thesis.txt").write_text("years of work")
    assert "already exists and is not empty" in refused(place, job, capsys)


def test_a_folder_inside_a_file_is_refused(place, capsys):
    (place / "file").write_text("not a folder")
    assert main(["run", str(written(place)), "--out", str(place / "file" / "out")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_folders_made_for_the_output_go_with_it(place, monkeypatch):
    def stop(*_args, **_more):
        raise KeyboardInterrupt

    monkeypatch.setattr("turnwright.job.run", stop)
    assert main(["run", str(written(place)), "--out", str(place / "deep" / "down" / "out")]) == 130
    assert not (place / "deep").exists()


def start(job, out, **more):
    code = "import sys; from turnwright.cli import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", code, "run", str(job), "--out", str(out)],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, **more,
    )  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [
        [("strategy.points_per_rev", 4000)],  # the program does not fit
        [("simulation.whole_part", {"radii": 500, "angles": 400})],  # the program does, a map does not
        [("simulation.whole_part", {"radii": 350, "angles": 350})],  # each map does, the archive of all does not
    ],
    ids=["program", "map", "archive"],
)
def test_a_full_disk_leaves_nothing(changes, tmp_path, capsys):
    """Oracle: the kernel ends every file at 1 MB, as a full disk would."""
    job = written(tmp_path, *changes)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, before[1]))
    try:
        code = main(["run", str(job), "--out", str(tmp_path / "out")])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    message = capsys.readouterr().err.splitlines()[-1]
    assert code == 2, message
    assert re.search(r"the largest that the system allows|File too large|the disk is full", message)
    assert f"{tmp_path}/." not in message  # the folder that was asked for, not the one of the meantime
    assert [entry.name for entry in tmp_path.iterdir()] == ["job.toml"]


@pytest.mark.usefixtures("signals_heard")
@pytest.mark.parametrize("kill", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.proof), signal.SIGHUP])
def test_an_interrupted_run_leaves_nothing(kill, tmp_path):
    process = start(LENS, tmp_path / "out")
    for line in process.stderr:
        if line.strip() == "plan":
            break
    process.send_signal(kill)
    message = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 128 + kill, message
    assert "turnwright: interrupted" in message
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("signals_heard")
@pytest.mark.parametrize("kill", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_at_the_very_start_is_obeyed(kill, tmp_path):
    code = f"""if True:
        import os, sys
        from turnwright import cli
        from turnwright import _signals
        class Struck(_signals.Stop):
            def __enter__(self):
                super().__enter__()
                os.kill(os.getpid(), {int(kill)})
                return self
        cli.Stop = Struck
        sys.exit(cli.main())
    """
    process = subprocess.run(
        [sys.executable, "-c", code, "run", str(LENS), "--out", str(tmp_path / "out")],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert process.returncode == 128 + kill, process.stderr
    assert process.stderr.splitlines()[-1].startswith("turnwright: interrupted")


def test_a_request_that_python_drops_is_not_reported_as_a_defect():
    """Oracle: Python drops what a finaliser raises, and reports it on standard error."""
    code = """if True:
        from turnwright._signals import Stop
        class Raises:
            def __init__(self, error): self.error = error
            def __del__(self): raise self.error
        with Stop():
            one = Raises(KeyboardInterrupt())
            del one
            other = Raises(ValueError("another"))
            del other
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.count("Traceback") == 1
    assert done.stderr.endswith("ValueError: another\n")


@pytest.mark.usefixtures("signals_heard")
@pytest.mark.parametrize(
    ("kill", "delay"), [(signal.SIGINT, 0.0), (signal.SIGHUP, 0.1), (signal.SIGINT, 0.3), (signal.SIGHUP, 0.6)]
)
def test_an_early_interrupt_is_not_lost(kill, delay, tmp_path):
    """Imports may swallow the exception; what was wanted is done all the same."""
    code = """if True:
        import sys
        from turnwright import cli
        from turnwright import _signals
        class Telling(_signals.Stop):
            def __enter__(self):
                super().__enter__()
                print("in", flush=True)
                return self
        cli.Stop = Telling
        sys.exit(cli.main())
    """
    process = subprocess.Popen(
        [sys.executable, "-c", code, "run", str(LENS), "--out", str(tmp_path / "out")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout.readline() == "in\n"
    time.sleep(delay)
    process.send_signal(kill)
    message = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 128 + kill, message
    assert message.splitlines()[-1].startswith("turnwright: interrupted")
    assert "Traceback (most recent call last)" not in message
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "place", ["part.surface.file", "part.correction", "part.material", "tool.waviness_file", "machine.file"]
)
def test_a_name_too_long_for_any_system_is_no_file(place, tmp_path, capsys):
    changes = [("part.surface", GRID)] if "surface" in place else [("machine", {})] if "machine" in place else []
    job = written(tmp_path, *changes, (place, "x" * 5000 + ".toml"))
    assert main(["check", str(job)]) == 2
    assert "does not exist in the folder of the job file" in capsys.readouterr().err


@pytest.mark.parametrize("door", ["check", "run"])
def test_a_speed_beyond_the_spindle_is_refused(door, tmp_path, capsys):
    job = written(tmp_path, ("strategy.spindle_speed", "1e5 rpm"))
    limit = Job.load(job).machine.spindle_rpm
    assert main([door, str(job), *(["--out", str(tmp_path / "out")] if door == "run" else [])]) == 2
    message = capsys.readouterr().err
    assert "is 100000 rpm" in message or "is 100000 rev/min" in message
    assert re.search(rf"the limit of .* is {limit:g} (rpm|rev/min)", message)


@pytest.mark.parametrize("door", ["check", "run"])
def test_an_arc_length_alone_is_refused_before_placing(place, door, capsys):
    """Near the axis it turns C by more than half a turn; a smaller one does not."""
    way = ("strategy", {"kind": "slow tool servo", "feed": "20 um/rev", "arc_length": "50 um"})
    job = written(place, way)
    assert main([door, str(job), *(["--out", str(place / "out")] if door == "run" else [])]) == 2
    shown = capsys.readouterr().err
    assert re.search(r"less than 180 deg .*, arc_length makes it .* deg .*: state max_step", shown)
    assert "place" not in shown
    way[1]["arc_length"] = "10 um"
    assert main(["check", str(written(place, way))]) == 0
