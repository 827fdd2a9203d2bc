"""Maps computed on a graphics card. Oracle: the same maps on processors, which have oracles of their own.

There is no card: numba's simulator runs the kernels in Python, and the compiler compiles them for cards.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import turnwright as tw
from moving_motions import CASES
from turnwright import generation
from turnwright.cli import main
from turnwright.studies import generate_tiled

WORK = Path(__file__).parents[1] / "support" / "card_cases.py"
TOLERANCE_MM = 1e-12
MOTION, EDGE = CASES["raked"]
AXIS = np.linspace(0.4, 0.5, 5)


def carried_out(*work, simulated=True):
    """Return what `card_cases` prints of some work, in a process in which numba has the simulator or not."""
    pytest.importorskip("numba_cuda")
    done = subprocess.run(
        [sys.executable, str(WORK), *work], capture_output=True, text=True, check=False, timeout=900,
        env={**os.environ, "NUMBA_ENABLE_CUDASIM": str(int(simulated))},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


def assert_equal(difference, heights=1):
    greatest, same_missing, present, _ = difference
    assert greatest <= TOLERANCE_MM
    assert same_missing
    assert present >= heights


@pytest.fixture(scope="module")
def simulated():
    """What one process of the simulator finds."""
    return carried_out("both", "upright", "lateral", "tiles")


@pytest.mark.parametrize("more", [False, pytest.param(True, marks=pytest.mark.proof)])
def test_maps_of_a_card_equal_those_of_processors(simulated, more):
    """Arcs, waviness, rake, moving Y, holes, the axis, and motions that leave points uncut."""
    for found in (carried_out("equal", "more") if more else simulated["equal"]).values():
        for difference in found.values():
            assert_equal(difference)
        assert any(missing for _, _, _, missing in found.values())


def test_a_card_of_little_memory_computes_a_group_at_a_time(simulated):
    found = simulated["memory"]
    assert_equal(found["difference"], 19 * 17)
    assert found["launches"] == 2 * 2
    assert found["progress"] == [[12, 17], [17, 17]]  # a group is 4 x 4 tiles of 3 x 3 points


def test_kernels_compile_for_cards_in_double_precision():
    found = carried_out("compile", simulated=False)
    if not found:
        pytest.skip("the libraries nvvm and nvrtc of CUDA are not installed")
    assert len(found) == 4 * 2
    for name, code in found.items():
        assert code["target"] == f"sm_{name.split()[1]}"
        assert code["double"] > 100
        assert code["single"] == 0


CALLS = {
    "generate": lambda device: tw.generate(MOTION, EDGE, x=AXIS, y=AXIS, device=device),
    "generate_polar": lambda device: tw.generate_polar(MOTION, EDGE, radius=AXIS, angle=AXIS, device=device),
    "generate_tiled": lambda device: generate_tiled(
        MOTION, EDGE, pixel=0.1, radius=0.5, store="never written", device=device
    ),
}


@pytest.mark.parametrize("call", CALLS)
def test_a_device_that_is_not_there_is_one_sentence(call, monkeypatch):
    with pytest.raises(tw.errors.InputError, match=r"device is 'gpu'.*cpu.*cuda"):
        CALLS[call]("gpu")
    monkeypatch.setattr(generation, "find_spec", lambda _name: None)
    with pytest.raises(tw.errors.InputError, match=r"numba-cuda.*'turnwright\[cuda\]'"):
        CALLS[call]("cuda")
    monkeypatch.setattr(generation, "find_spec", lambda _name: "there")
    monkeypatch.setattr(pytest.importorskip("numba.cuda"), "is_available", lambda: False)
    with pytest.raises(tw.errors.InputError, match=r"graphics card.*driver"):
        CALLS[call]("cuda")


def test_command_refuses_a_device_before_it_plans(tmp_path, capsys):
    job = Path(__file__).parents[2] / "examples" / "li2018_sine_grid.toml"
    assert main(["tile", str(job), "--pixel", "1 um", "--out", str(tmp_path / "out"), "--device", "gpu"]) == 2
    assert "device is 'gpu'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
