"""The first run on a machine: a second process compiles the kernels of the simulation."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from turnwright._kernels import compiling

EXAMPLE = Path(__file__).parents[2] / "examples" / "li2018_sine_grid.toml"


@pytest.fixture
def kernels(tmp_path, monkeypatch):
    """An empty folder of compiled kernels."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    compiling.cache_folder.cache_clear()
    yield tmp_path
    compiling.cache_folder.cache_clear()


def test_one_process_is_started_and_waited_for(kernels, tmp_path):
    note = tmp_path / "note"
    code = f"import time; time.sleep(0.5); open({str(note)!r}, 'a').write('compiled ')"
    compiling.compile_ahead("generation", ("grid",), code)
    compiling.compile_ahead("generation", ("grid",), code)
    begin = time.perf_counter()
    assert compiling._was_compiled_ahead("grid")
    assert note.read_text() == "compiled "
    assert time.perf_counter() - begin > 0.1
    assert not compiling._was_compiled_ahead("grid")
    (compiling.cache_folder("generation") / "one.kernel").touch()
    compiling.compile_ahead("generation", ("grid",), code)
    assert not compiling._was_compiled_ahead("grid")


def test_a_folder_that_cannot_be_written_starts_nothing(kernels, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    compiling.cache_folder.cache_clear()
    compiling.compile_ahead("generation", ("grid",), "raise SystemExit")
    assert not compiling._was_compiled_ahead("grid")


def test_modules_in_the_folder_of_the_user_are_not_imported(kernels, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "platformdirs.py").write_text("raise SystemExit")
    note = tmp_path / "note"
    compiling.compile_ahead(
        "generation", ("grid",), f"import platformdirs; open({str(note)!r}, 'w').write('the real one')"
    )
    assert compiling._was_compiled_ahead("grid")
    assert note.read_text() == "the real one"


@pytest.mark.proof
def test_a_run_compiles_no_kernel_of_the_simulation_after_that(kernels, tmp_path):
    """The files of both kernels are those of `compile_simulation`, so their signatures are right."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(kernels)}

    def python(*arguments):
        subprocess.run([sys.executable, *arguments], check=True, env=environment, capture_output=True)

    def simulation():
        return {file.name for name in ("scattered", "grid") for file in kernels.glob(f"*/*/{name}-*.kernel")}

    python("-c", "from turnwright.job import compile_simulation; compile_simulation()")
    before = simulation()
    assert len(before) == 2
    python("-m", "turnwright", "run", str(EXAMPLE), "--out", str(tmp_path / "out"))
    assert simulation() == before
