"""Compiled kernels are kept until they, or what they call, are edited. Oracle: Python's own parser of imports."""

import ast
import shutil
from pathlib import Path

import numba
import pytest

from turnwright import _kernels
from turnwright._kernels import edge, sines, trig

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


@pytest.mark.parametrize("edited", ["trig", "edge", "generation", "chip", "text", "__init__"])
def test_an_edit_leaves_only_the_kernels_that_have_nothing_to_do_with_it(edited, tmp_path):
    copy = shutil.copytree(FOLDER, tmp_path / "kernels")
    names = sorted(file.stem for file in copy.glob("*.py"))
    before = {name: _kernels._digest(copy, name) for name in names}
    source = copy / f"{edited}.py"
    source.write_text(source.read_text(encoding="utf-8") + "# edited\n", encoding="utf-8")
    changed = {name for name in names if _kernels._digest(copy, name) != before[name]}
    assert changed == {name for name in names if edited in {name, "__init__"} | called(name)}


def test_each_module_has_a_folder_and_other_compiled_functions_keep_theirs():
    places = {one.__name__: Path(function.stats.cache_path).parent.name for one, function in (
        (edge, edge.height), (sines, sines.wave), (trig, trig.sincos),
    )}  # fmt: skip
    for name, place in places.items():
        assert place == f"kernels-{name.rpartition('.')[2]}-{_kernels._digest(FOLDER, name.rpartition('.')[2])}"
    assert "kernels-" not in numba.config.CACHE_DIR
