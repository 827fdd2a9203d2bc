"""Figures drawn by other processes. Oracle: the same figures drawn by this one."""

import re
import subprocess
import sys

import pytest

from job_files import changed, written
from turnwright.job import Job, break_down_error, compare, run
from turnwright.report import (
    compose_report,
    draw_ahead,
    draw_apart,
    draw_candidate,
    drawing,
    figures,
    write_comparison,
    write_page,
    write_report,
)
from turnwright.report.page import Drawing

PASSES = (
    ("part.stock", "10 um"),
    ("part.material", "IRG 26"),
    ("machine", {"name": "nanotech-350fg"}),
    ("passes", [{"name": "rough", "allowance": "2 um"}, {"name": "finish"}]),
)


@pytest.fixture(scope="module")
def result():
    return run(Job.read(changed()))


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    monkeypatch.setattr(drawing, "cores", lambda: 2)


def ordered(page):
    return [item for section in page.sections for item in section.items if isinstance(item, Drawing)]


def has_ended(process):
    process.join(10)
    return not process.is_alive()


def test_other_processes_draw_the_same_page(result, tmp_path):
    here, apart = tmp_path / "here.html", tmp_path / "apart.html"
    write_report(result, here)
    with draw_apart():
        processes = drawing._apart[-1].context.processes
        draw_ahead(result.job)
        page = compose_report(result, apart)
        first, *_, last = ordered(page)
        assert first.picture().svg.startswith("<svg")
        write_page(page, apart)
        assert first._future is drawing._apart[-1].order(figures.sag_map, result.job.part)
        assert last._future.done()
    assert all(map(has_ended, processes))
    assert not drawing._apart
    assert apart.read_text(encoding="utf-8") == here.read_text(encoding="utf-8")


def drawn(text):
    """Return the figures of a page; the run states its times."""
    return re.findall(r"<svg.*?</svg>", text, re.DOTALL)


@pytest.mark.parametrize("job", [(), PASSES], ids=["one pass", "two passes with chips"])
def test_all_figures_of_a_run_are_ordered_before_its_page(job, tmp_path):
    job = Job.read(changed(*job))
    with draw_apart():
        done = run(job, ready=draw_ahead(job))
        count = len(drawing._apart[-1].ordered)
        page = compose_report(done, tmp_path)
        assert len(ordered(page)) == count == len(drawing._apart[-1].ordered)
        apart = write_page(page, tmp_path / "apart.html")
    here = write_report(done, tmp_path / "here.html")
    assert drawn(apart.read_text(encoding="utf-8")) == drawn(here.read_text(encoding="utf-8"))


def test_error_maps_of_a_comparison_are_ordered_while_it_goes_on(tmp_path, monkeypatch):
    known = []  # errors of the first strategy, taken for those of all: they are most of the time of a comparison

    def first(*given, **named):
        if not known:
            known.append(break_down_error(*given, **named))
        return known[0]

    monkeypatch.setattr("turnwright.job.pipeline.break_down_error", first)
    job, ready = Job.read(changed(("part.radius", "0.3 mm"), ("simulation.patches", []))), []
    with draw_apart():
        done = compare(job, ready=lambda candidate: ready.append((candidate, draw_candidate(job, candidate))))
        count = len(drawing._apart[-1].ordered)
        apart = write_comparison(done, tmp_path / "apart.html")
        assert len(drawing._apart[-1].ordered) == count + 2
    assert tuple(candidate for candidate, _ in ready) == done.candidates
    assert count == sum(len(drawings) for _, drawings in ready) > 0
    here = write_comparison(done, tmp_path / "here.html")
    assert apart.read_text(encoding="utf-8") == here.read_text(encoding="utf-8")


def test_figures_are_drawn_here_when_a_process_is_killed(result, tmp_path):
    with draw_apart():
        apart = drawing._apart[-1]
        apart.context.processes[0].kill()
        page = compose_report(result, tmp_path)
        write_page(page, tmp_path / "killed.html")
        write_page(compose_report(result, tmp_path), tmp_path / "again.html")
    write_report(result, tmp_path / "here.html")
    text = (tmp_path / "here.html").read_text(encoding="utf-8")
    assert (tmp_path / "killed.html").read_text(encoding="utf-8") == text
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == text


def test_a_figure_that_cannot_be_drawn_raises_here(result):
    with draw_apart():
        order = drawing.draw(figures.sag_map, None)
        with pytest.raises(AttributeError):
            order.picture()


def test_an_interrupt_ends_the_processes():
    processes = []

    def interrupted():
        with draw_apart():
            processes.extend(drawing._apart[-1].context.processes)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert processes
    assert all(map(has_ended, processes))


def test_one_core_draws_alone(result, monkeypatch):
    monkeypatch.setattr(drawing, "cores", lambda: 1)
    with draw_apart():
        assert not drawing._apart
        assert drawing.draw(figures.sag_map, result.job.part)._future is None


def test_a_process_that_starts_reports_no_interrupt():
    code = (
        "import os, signal; from turnwright.report import drawing; drawing.cores = lambda: 2\n"
        "with drawing.draw_apart():\n"
        "    os.kill(drawing._apart[-1].context.processes[0].pid, signal.SIGINT)\n"
        "    print(drawing._apart[-1].order(abs, -1).result())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("1\n", "")


def test_a_script_without_a_guard_is_run_once(tmp_path):
    job = written(tmp_path)
    script = tmp_path / "script.py"
    script.write_text(
        "from turnwright.cli import main\nfrom turnwright.report import drawing\n"
        "drawing.cores = lambda: 2\nprint('once', flush=True)\n"
        f"main(['run', {str(job)!r}, '--out', {str(tmp_path / 'out')!r}])\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
    assert done.stdout.count("once") == 1
    assert "Traceback" not in done.stderr
    assert (tmp_path / "out" / "report.html").is_file()
