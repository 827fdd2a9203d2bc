"""Compiled kernels are kept until they, or what they call, are edited. Oracle: Python's own parser of imports."""

import ast
import hashlib
import os
import pickle  # noqa: TID251 - a damaged file may be one
import shutil
import subprocess
import sys
from collections import namedtuple
from pathlib import Path

import numba
import pytest
import tomli_w

from job_files import changed
from turnwright import _kernels
from turnwright._kernels import compiling, edge, sines, trig

FOLDER = Path(_kernels.__file__).parent


def called(name):
    """Return the kernel modules that one imports, and those that they import."""
    found = set()
    for node in ast.walk(ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))):
        names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or "."] if isinstance(node, ast.ImportFrom) else []
        if isinstance(node, ast.ImportFrom) and node.module == "turnwright._kernels":
            assert {one.name for one in node.names} <= set(_kernels.__all__)  # a module would be called unseen
        for one in names:
            assert not one.startswith((".", "turnwright")) or one.startswith("turnwright._kernels"), one
            found |= {part for part in one.split(".")[2:] if one.startswith("turnwright._kernels")}
    return found.union(*map(called, found))


@pytest.mark.parametrize(
    "edited",
    [
        "trig",
        "generation",
        "__init__",
        *(pytest.param(one, marks=pytest.mark.proof) for one in ("edge", "chip", "text")),
    ],
)
def test_an_edit_renews_only_dependent_kernels(edited, tmp_path):
    copy = shutil.copytree(FOLDER, tmp_path / "kernels")
    names = sorted(file.stem for file in copy.glob("*.py"))
    before = {name: compiling._digest(copy, name) for name in names}
    source = copy / f"{edited}.py"
    source.write_text(source.read_text(encoding="utf-8") + "# edited\n", encoding="utf-8")
    changed = {name for name in names if compiling._digest(copy, name) != before[name]}
    assert changed == {name for name in names if edited in {name, "__init__"} | called(name)}


def test_each_kernel_module_has_its_folder():
    places = {one.__name__: Path(function.dispatcher.stats.cache_path).parent.name for one, function in (
        (edge, edge.height), (sines, sines.wave), (trig, trig.sincos),
    )}  # fmt: skip
    for name, place in places.items():
        assert place == f"kernels-{name.rpartition('.')[2]}-{compiling._digest(FOLDER, name.rpartition('.')[2])}"
    assert "kernels-" not in numba.config.CACHE_DIR


def linear(x):
    return 2.5 * x + 0.25


def linear_again():
    """A kernel as a new process meets it, and whether its code comes from the disk when it is called."""
    kernel = _kernels.jit(linear)
    assert kernel(3.0) == 7.75  # 2.5 * 3 + 0.25
    assert kernel(2) == 5.25
    return sum(kernel.dispatcher.stats.cache_hits.values())


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The folder of a kernel that is kept for two signatures."""
    folder = tmp_path_factory.mktemp("kernel")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiling, "cache_folder", lambda _module: folder)
        assert linear_again() == 0
        assert linear_again() == 2
    assert len(list(folder.iterdir())) == 2
    return folder


@pytest.fixture
def kept(compiled, tmp_path, monkeypatch):
    """A copy of this folder, of which the kernel comes as well."""
    folder = shutil.copytree(compiled, tmp_path / "kept")
    monkeypatch.setattr(compiling, "cache_folder", lambda _module: folder)
    assert linear_again() == 2
    return folder


DAMAGE = {
    "empty": lambda _: b"",
    "cut to 1000 bytes": lambda data: data[:1000],
    "without its end": lambda data: data[:-1],
    "with more at its end": lambda data: data + b"x",
    "zeros": lambda data: bytes(len(data)),
    "text": lambda _: b"not compiled code",
    "another pickle": lambda _: hashlib.sha256(pickle.dumps(7)).digest() + pickle.dumps(7),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_kernel_is_compiled_again(kind, kept):
    """Oracle: its closed form. numba's own cache ended each call with EOFError, UnpicklingError or a signal."""
    for file in kept.iterdir():
        file.write_bytes(DAMAGE[kind](file.read_bytes()))
    assert linear_again() == 0
    assert linear_again() == 2  # and is kept again


def test_no_flipped_byte_is_run(kept):
    files = list(kept.iterdir())
    whole = {file: file.read_bytes() for file in files}
    for first in range(2):
        for part, (file, data) in zip((first, first + 2), whole.items(), strict=True):
            at = part * len(data) // 4 + part
            file.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        assert linear_again() == 0


def test_the_code_of_another_signature_is_not_run(kept):
    one, other = kept.iterdir()
    data = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(data)
    assert linear_again() == 0


def first(pair):
    return pair.first


def test_a_kernel_of_a_named_tuple_is_kept_by_its_fields(tmp_path, monkeypatch):
    """numba's type of a named tuple has its name and the types of its fields, so that exchanged ones look alike."""
    monkeypatch.setattr(compiling, "cache_folder", lambda _module: tmp_path)
    for fields, hits in (("first second", 0), ("first second", 1), ("second first", 0)):
        pair = namedtuple("Pair", fields)  # noqa: PYI024 - two of one name, in turn
        monkeypatch.setattr(sys.modules[__name__], "Pair", pair, raising=False)
        kernel = _kernels.jit(first)
        assert kernel(pair(first=1.5, second=2.5)) == 1.5
        assert sum(kernel.dispatcher.stats.cache_hits.values()) == hits


def test_a_place_that_takes_no_file_costs_only_time(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setattr(compiling, "cache_folder", lambda _module: tmp_path / "file" / "kernels")
    assert linear_again() == 0
    assert linear_again() == 0


def test_a_full_disk_of_the_cache_is_not_noticed(tmp_path):
    """Oracle: the system ends every file at 2 kB, as a full disk would, and no part of one stays."""
    resource = pytest.importorskip("resource")
    code = (
        "import resource, signal, numpy as np\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n"
        "from turnwright.surface import SineGrid\n"
        "print(SineGrid(amplitude=(1.0, 0.0), period=(4.0, 4.0)).sag(1.0, 0.0).item())\n"
    )
    # Bytecode would be cut as well, and kept.
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False, timeout=600
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert float(done.stdout) == pytest.approx(1.0, abs=1e-12)
    assert resource
    assert not [file for file in tmp_path.rglob("*") if file.is_file()]


def test_what_is_compiled_is_logged_once(tmp_path):
    code = (
        "import logging, sys\n"
        "logging.basicConfig(level=logging.WARNING, stream=sys.stdout, format='%(message)s')\n"
        "logging.getLogger('turnwright._kernels').setLevel(logging.INFO)\n"
        "from turnwright.surface import SineGrid\n"
        "SineGrid(amplitude=(1.0, 0.0), period=(4.0, 4.0)).sag(1.0, 0.0)\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    printed = [
        subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert set(printed[0].splitlines()) == {f"compiling {name}, once on this machine" for name in ("sines", "trig")}
    assert printed[1] == ""


def test_loading_compiled_kernels_imports_nothing_that_compiles():
    """The oracle is Python's list of imported modules; the first of two processes may compile what is missing."""
    code = (
        "import sys, tomllib\n"
        "from turnwright.job import Job, run\n"
        "run(Job.read(tomllib.loads(sys.argv[1])))\n"
        "print(*sys.modules)"
    )
    compilers = {"numba.np.arraymath", "numba.np.arrayobj", "numba.np.linalg", "scipy.fft", "scipy.linalg"}
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", code, tomli_w.dumps(changed())], capture_output=True, text=True, check=True
        )
        modules = set(done.stdout.split())
        if not compilers & modules:
            break
    assert "numba" in modules
    assert not compilers & modules


def test_an_error_in_a_function_of_numba_is_raised_by_kept_code(tmp_path):
    code = (
        "import pathlib, sys, numpy as np\n"
        "from turnwright import _kernels\n"
        "from turnwright._kernels import compiling\n"
        "compiling.cache_folder = lambda _module: pathlib.Path(sys.argv[1])\n"
        "kernel = _kernels.jit(lambda n: np.empty(n).size)\n"
        "try:\n"
        "    kernel(kernel(1) - 2)\n"
        "except ValueError as error:\n"
        "    print(sum(kernel.dispatcher.stats.cache_hits.values()), error)"
    )
    for hits in (0, 1):
        done = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=True)
        assert done.stdout == f"{hits} negative dimensions not allowed\n"
