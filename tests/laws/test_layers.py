"""The contracts of the house see what they forbid. Oracle: a copy of it with one forbidden import more."""

import shutil
import subprocess
import sys
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[2]

FORBIDDEN = {
    "The simulator never sees the planner": ("generation.py", "from turnwright.placing import touch"),
    "One way up: doors > studies > job > stages > things > ground": ("tool.py", "from turnwright.access import Access"),
    "Only doors draw pictures and talk": ("tracking.py", "import matplotlib"),
    "metrology is private behind its door": (
        "job/prediction.py",
        "from turnwright.metrology.clean import remove_outliers",
    ),
    "No circles among siblings": ("pose.py", "from turnwright.heightmap import HeightMap"),
}


@pytest.mark.parametrize("contract", FORBIDDEN)
def test_a_forbidden_import_breaks_its_contract(contract, tmp_path):
    shutil.copytree(ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("static", "__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    name, line = FORBIDDEN[contract]
    file = tmp_path / "src" / "turnwright" / name
    source = file.read_text(encoding="utf-8")
    file.write_text(source.replace("\nimport ", f"\n{line}\nimport ", 1), encoding="utf-8")
    assert line in file.read_text(encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as lint; lint()", "--no-cache"],
        cwd=tmp_path, env={"PYTHONPATH": str(tmp_path / "src")}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stdout + done.stderr
    assert f"{contract} BROKEN" in " ".join(done.stdout.split())


def test_modules_import_each_other_in_one_direction():
    # A sum of surfaces is a surface that `+` makes, and a surface reads surfaces of every family from a job file.
    recursive = {f"turnwright.surface.{name}" for name in ("base", "compound", "stated")}
    graph = grimp.build_graph("turnwright", cache_dir=None)
    imports = {name: graph.find_modules_directly_imported_by(name) - recursive for name in graph.modules}
    while leaves := [name for name, imported in imports.items() if not imported & imports.keys()]:
        for name in leaves:
            del imports[name]
    assert not imports
