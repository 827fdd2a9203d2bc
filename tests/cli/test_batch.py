"""Several jobs at once: each in its own folder, one that fails holds up no other, and nothing is done twice."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
import tomli_w

from job_files import changed
from patience import PATIENCE_S
from turnwright.cli import main


def jobs(folder, **changes):
    """Write jobs by name; the changes are (dotted place, value) pairs."""
    files = []
    for name, change in changes.items():
        files.append(folder / f"{name}.toml")
        files[-1].write_text(tomli_w.dumps(changed(*change)), encoding="utf-8")
    return [str(file) for file in files]


COARSE = ("strategy.feed", "40 um/rev")
BARE = ("simulation", {})


@pytest.mark.usefixtures("in_this_process")
def test_each_job_is_a_line_and_a_folder_and_none_is_done_twice(tmp_path, capsys):
    files = jobs(
        tmp_path, good=[COARSE], wrong=[("tool.nose_radius", "3 apples")], other=[BARE, ("strategy.feed", "50 um/rev")]
    )
    out = tmp_path / "out"
    command = ["run", *files, str(tmp_path / "gone.toml"), "--out", str(out)]
    assert main([*command, "--workers", "2"]) == 2
    good, wrong, other, gone, last = capsys.readouterr().out.splitlines()
    assert good.startswith("good   ")
    assert "patch Sq" in good
    assert wrong.startswith("wrong  failed: tool.nose_radius: '3 apples' has the unit 'apples'")
    assert other.startswith("other  ")
    assert gone.startswith("gone   failed: the job file")
    assert last == f"2 of 4 jobs are done, their reports are in {out}/JOB/report.html"
    assert sorted(file.name for file in out.iterdir()) == ["good", "other"]
    assert {"report.html", "result.json", "part.nc", "case.json"} <= {file.name for file in (out / "good").iterdir()}
    assert json.loads((out / "good" / "result.json").read_text())["passes"][0]["feed"] == pytest.approx(0.04)

    before = {file: file.stat().st_mtime_ns for file in out.rglob("*")}
    jobs(tmp_path, other=[BARE, COARSE])
    assert main([*command, "--workers", "1"]) == 2
    good, wrong, other, gone, last = capsys.readouterr().out.splitlines()
    assert good.startswith("good   already done: ")
    assert other.startswith("other  failed: ")
    assert "already exists and is not empty" in other  # it is the folder of another job by now
    assert {file: file.stat().st_mtime_ns for file in out.rglob("*")} == before

    assert main([*command[:2], files[2], "--out", str(out), "--force"]) == 0
    assert "already done" not in capsys.readouterr().out.splitlines()[1]
    assert sorted(file.name for file in out.iterdir()) == ["good", "other", "other.old-1"]

    (out / "good" / "case.json").write_text("[1]")  # another program's
    assert main([*command[:2], files[2], "--out", str(out)]) == 2
    assert "already exists and is not empty" in capsys.readouterr().out.splitlines()[0]


def at_work(session):
    """Whether a process of the session goes on; one that has ended and waits to be counted does not."""
    found = subprocess.run(["ps", "-e", "-o", "sid=,stat="], capture_output=True, text=True, check=True)
    return any(
        int(number) == session and not state.startswith("Z")
        for number, state in map(str.split, found.stdout.splitlines())
    )


@pytest.mark.usefixtures("signals_heard")
def test_an_interrupted_study_keeps_finished_rows(tmp_path):
    """Ctrl-C in the second of three jobs, kill -9 in the third when the command is repeated; then it is finished."""
    files = jobs(tmp_path, **{f"job{n}": [BARE, ("strategy.feed", f"{40 + n} um/rev")] for n in range(3)})
    out = tmp_path / "out"
    command = [sys.executable, "-m", "turnwright", "run", *files, "--out", str(out), "--workers", "1"]
    for done, how in ((1, signal.SIGINT), (2, signal.SIGKILL)):
        process = subprocess.Popen(
            command, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        start = time.monotonic()
        while len(list(out.glob("*"))) <= done or not (out / f"job{done - 1}").exists():  # the next is on its way
            assert time.monotonic() - start < PATIENCE_S
            time.sleep(0.01)
        if how == signal.SIGINT:
            os.killpg(process.pid, how)
        else:
            process.kill()
        message = process.communicate(timeout=PATIENCE_S)[1]
        assert process.returncode == (130 if how == signal.SIGINT else -signal.SIGKILL)
        if how == signal.SIGINT:
            assert message.splitlines()[-1] == (
                f"turnwright: interrupted, finished jobs are in {out}: repeat the command to continue"
            )
            assert "Traceback" not in message
        while at_work(process.pid):  # its worker notices
            assert time.monotonic() - start < PATIENCE_S
            time.sleep(0.05)
        # No half of a folder, and no hidden one.
        kept = {f"job{n}" for n in range(done)}
        assert kept <= {one.name for one in out.iterdir()} <= kept | {f"job{done}"}
        before = {file: file.stat().st_mtime_ns for name in kept for file in (out / name).iterdir()}
    assert main(command[3:]) == 0
    assert {file: file.stat().st_mtime_ns for file in before} == before
    assert sorted(one.name for one in out.iterdir()) == ["job0", "job1", "job2"]


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ([], "2 jobs are named 'a'"),
        (["b"], "the number of workers is 0, it must be a whole number, 1 to 1000: give one"),
    ],
)
def test_a_batch_that_cannot_be_is_refused_first(more, sentence, tmp_path, capsys):
    (tmp_path / "sub").mkdir()
    files = [*jobs(tmp_path, a=[]), *jobs(tmp_path / "sub", **{name: [] for name in more or ["a"]})]
    assert main(["run", *files, "--out", str(tmp_path / "out"), "--workers", "0"]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_batch_of_failures_leaves_nothing(tmp_path, capsys):
    files = [str(tmp_path / f"{name}.toml") for name in "ab"]
    assert main(["run", *files, "--out", str(tmp_path / "deep" / "out")]) == 2
    assert capsys.readouterr().out.splitlines()[-1].startswith("0 of 2 jobs are done")
    assert not (tmp_path / "deep").exists()
