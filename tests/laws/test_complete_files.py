"""Results that are cut off while they are written: what stood there stays, and no half of a file has its name.

Oracle: a full disk, played by the limit that the system sets on the size of a file.
"""

import subprocess
import sys

import pytest

pytest.importorskip("resource")

LIMIT = 4096
FILL = """
import resource, signal, sys
from pathlib import Path
from types import SimpleNamespace
import numpy as np
from turnwright import report
from turnwright.report import archive
from turnwright.heightmap import HeightMap

def maps(folder):
    heights = HeightMap(x=np.arange(50.0), y=np.arange(50.0), z=np.zeros((50, 50)))
    one = SimpleNamespace(name="rim", error=heights, tracking=None, tracking_nm=None, roughness=None)
    report.write_maps([one], folder)

def spectrum(folder):
    made = SimpleNamespace(shape=(2, 2), pixel=(1.0, 1.0), extent=(0.0, 1.0, 0.0, 1.0))
    density = SimpleNamespace(unit="nm^2 mm", frequency=np.arange(900.0), density=np.arange(900.0))
    report.archive_tiled(made, None, density, folder)

def numbers(folder):
    archive._write_json(folder / "numbers.json", {"all": list(range(5000))})

def picture(folder):
    force = np.ones((2, 1))
    fit = SimpleNamespace(components=("cutting",), thickness=np.arange(2.0), measured=force, fitted=force)
    found = SimpleNamespace(name="x", learned=SimpleNamespace(fit=fit, critical=None))
    report.write_fit_picture(found, folder / "picture.png")

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # the system then says that the file is too large
work, folder = globals()[sys.argv[1]], Path(sys.argv[2])
import matplotlib.figure, matplotlib.backends.backend_agg
sys.dont_write_bytecode = True  # it would be cut, and kept
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
try:
    work(folder)
except OSError as error:
    sys.exit(f"errno {error.errno}")
"""


@pytest.mark.parametrize(
    ("work", "name"),
    [
        ("maps", "maps/rim.npy"),
        pytest.param("spectrum", "spectrum.csv", marks=pytest.mark.proof),
        pytest.param("numbers", "numbers.json", marks=pytest.mark.proof),
        ("picture", "picture.png"),
    ],
)
def test_a_full_disk_leaves_no_half_of_a_result(tmp_path, work, name):
    file = tmp_path / name
    if work != "maps":
        file.write_text("as it was")
    done = subprocess.run(
        [sys.executable, "-c", FILL, work, str(tmp_path), str(LIMIT)], capture_output=True, text=True, check=False
    )
    assert done.stderr.strip().splitlines()[-1].startswith("errno"), done.stderr
    assert done.returncode == 1
    if work == "maps":
        assert not file.exists()
    else:
        assert file.read_text() == "as it was"
    assert not list(tmp_path.rglob(".*.part"))
