"""How a command ends: every stated tolerance kept, or the code that says what stands against it."""

import json
import os
import re
import signal
import subprocess
import sys

import pytest
import tomli_w

from turnwright.cli import main

DISH = {
    "part": {"name": "dish", "radius": "0.4 mm", "surface": {"family": "sphere", "radius": "20 mm"}},
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {"kind": "slow tool servo", "feed": "10 um/rev", "points_per_rev": 180, "spindle_speed": "60 rpm"},
    "simulation": {"whole_part": {"radii": 40, "angles": 36}},
}


def job_file(place, name, **tables):
    file = place / f"{name}.toml"
    file.write_text(tomli_w.dumps(DISH | tables), encoding="utf-8")
    return str(file)


@pytest.mark.parametrize(("limit", "code", "head"), [("40 nm", 4, "Not ready"), ("80 nm", 0, "Ready to cut")])
def test_run_ends_by_its_tolerances(limit, code, head, tmp_path, capsys):
    file = job_file(tmp_path, "dish", tolerances={"form_pv": limit})
    assert main(["run", file, "--out", str(tmp_path / "out")]) == code
    message = capsys.readouterr()
    found = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert found["keeps_tolerances"] is (code == 0)
    assert found["verdicts"][0]["kept"] is (code == 0)
    assert found["predictions"][0]["pv_nm"] > 50
    assert head in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert ("missed" in message.out) is (code == 4)


def test_a_speed_that_the_path_is_too_short_for_ends_with_2(tmp_path, capsys):
    """Oracle: C needs half of the path, about 20 turns, to come to sqrt(10 * 63) rad/s, 240 rev/min."""
    (tmp_path / "pvt.toml").write_text(
        'base = "nanoform"\nname = "pvt"\ndialect = "pmac"\naxes.C.acceleration = "10 rad/s^2"\n'
        '[controller]\ninterpolation = "hermite"\n',
        encoding="utf-8",
    )
    machine, strategy = {"file": "pvt.toml"}, {**DISH["strategy"], "feed": "20 um/rev", "points_per_rev": 36}
    for speed, code in (("260 rpm", 2), ("200 rpm", 0)):
        file = job_file(tmp_path, speed[:3], machine=machine, strategy={**strategy, "spindle_speed": speed})
        assert main(["run", file, "--out", str(tmp_path / f"out {speed}")]) == code
        message = capsys.readouterr()
        if code:
            assert re.search(r"spindle_rpm is 260 rev/min, .* 24\d\.\d+ rev/min \(by the C acceleration", message.err)
        else:
            assert " min at 200 rpm, limited by spindle speed as stated" in message.out
            assert "200 rev/min" in (tmp_path / f"out {speed}" / "report.html").read_text(encoding="utf-8")


def test_check_says_which_tolerances_it_does_not_judge(tmp_path, capsys):
    file = job_file(tmp_path, "dish", tolerances={"form_pv": "40 nm", "sq": "1 nm"})
    assert main(["check", file]) == 0
    message = capsys.readouterr().out
    assert message.count("not evaluated") == 2


@pytest.mark.usefixtures("in_this_process")
def test_a_batch_ends_with_the_gravest_code(tmp_path, capsys):
    good = job_file(tmp_path, "good", tolerances={"form_pv": "80 nm"})
    over = job_file(tmp_path, "over", tolerances={"form_pv": "40 nm"})
    wrong = job_file(tmp_path, "wrong", strategy={})
    assert main(["run", good, over, "--out", str(tmp_path / "two"), "--workers", "1"]) == 4
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("(exit code 0)")
    assert lines[1].endswith("(exit code 4)")
    assert main(["run", over, wrong, "--out", str(tmp_path / "two"), "--workers", "1"]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("over   already done: ")
    assert lines[0].endswith("(exit code 4)")
    assert lines[1].endswith("(exit code 2)")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no locks on folders")
def test_a_second_run_into_a_folder_is_refused_at_once(tmp_path):
    program = (
        "import sys, time; from pathlib import Path; from turnwright._signals import Stop\n"
        "from turnwright.cli.shared import Session, new_folder\n"
        "with Stop() as stop, new_folder(Path(sys.argv[1]), Session(stop), force=False):\n"
        "    print('at work', flush=True); time.sleep(600)\n"
    )

    def started(name):
        process = subprocess.Popen(
            [sys.executable, "-c", program, str(tmp_path / name)], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout.readline() == "at work\n"
        return process

    first = started("out")
    file = job_file(tmp_path, "dish")
    assert main(["run", file, "--out", str(tmp_path / "out")]) == 2
    assert first.poll() is None
    first.send_signal(signal.SIGKILL)
    first.communicate()
    assert [one for one in tmp_path.iterdir() if one.name.startswith(".out-")]
    other = started("other")
    assert not [one for one in tmp_path.iterdir() if one.name.startswith(".out-")]
    other.kill()
    other.communicate()
