"""The generation on a graphics card that is none: numba's simulator, and the compiler without a card.

    NUMBA_ENABLE_CUDASIM=1 python card_cases.py equal upright tiles

computes maps on processors and in the simulator and prints what differs; ``compile`` compiles the kernels for cards and
prints what they are made of. A process of its own, as numba reads the variable when it is imported.
"""

import json
import re
import sys
import tempfile
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import turnwright as tw
from moving_motions import CASES, ROUND, TABLE, moving, reach, tool
from turnwright import generation
from turnwright.generation import Prepared, grid_distances

CARDS = ((8, 0), (9, 0))
"""Compute capabilities of the cards that the kernels are compiled for."""


def still(c, _x):
    return np.zeros_like(c)


UPRIGHT = {
    "inside out, narrow": (moving(still, inside_out=True), tool(included=np.deg2rad(10), offset=(0.013, 0.0, 0.002))),
    "not convex": (moving(still, radius=0.5), tool(waviness=TABLE)),
    "a third of a turn": (moving(still, radius=0.01, feed=0.03), ROUND),
}
MORE = {
    "upright, round": (moving(still), ROUND),
    "upright, wavy, falling angle": (moving(still, sense=-1), tool(waviness=(1e-3, 0.01, -0.02), radius_error=0.01)),
    "upright, beyond the axis, half a circle": (moving(still, beyond=0.1), tw.Tool(nose_radius=0.3)),
    "upright, thousands of turns before": (moving(still, first=3e4), ROUND),
}
MOTIONS = {"upright": UPRIGHT, "lateral": {"raked": CASES["raked, height error"]}, "more": MORE | CASES}


def one_after_the_other():
    """Let each thread of the simulator end before the next begins: ours never wait for each other.

    Asked in a loop whether they are at an end, as it does, they share the processor with that loop.
    """
    from numba.cuda.simulator.kernel import BlockThread

    def start(thread):
        threading.Thread.start(thread)
        thread.join()

    BlockThread.start = start


def maps(motion, edge, device):
    """Coarse maps with the axis, one of them with holes, and fine ones, one of them across the azimuth pi."""
    size = reach(motion)
    disc, fine = size * np.linspace(-1, 1, 7), 0.004 * size * np.arange(6)
    turn = np.linspace(0, 2 * np.pi, 6)
    holes = np.hypot(disc, disc[:, None]) < size
    holes[2, 4:] = False
    ready = Prepared.of(motion, edge, None, distances=grid_distances(disc, disc), most_rings=81, device=device)
    return {
        "coarse": tw.generate(motion, edge, x=disc, y=disc, device=device).z,
        "fine": tw.generate(motion, edge, x=fine - 0.5 * size, y=fine[:4] - 0.01 * size, device=device).z,
        "polar": tw.generate_polar(motion, edge, radius=np.linspace(0, size, 5), angle=turn, device=device).z,
        "close polar": tw.generate_polar(motion, edge, radius=size / 2 + fine, angle=0.01 * turn, device=device).z,
        "holes": ready.fill_grid(disc, disc, inside=holes),
    }


def in_tiles(motion, edge, device):
    with tempfile.TemporaryDirectory() as folder:
        options = {"pixel": 0.1, "radius": 0.8, "tile": 64, "device": device}
        made = tw.studies.generate_tiled(motion, edge, store=Path(folder) / "map", **options)
        return {"tiles": made.window(x=(-0.8, 0.8), y=(-0.8, 0.8), pixels=17).z}


def differences(one, other):
    """Return the greatest difference, whether nan is in the same places, and the numbers of heights and of nan."""
    missing = np.isnan(one)
    greatest = float(np.abs(one - other)[~missing].max(initial=0.0))
    return greatest, bool(np.array_equal(missing, np.isnan(other))), int((~missing).sum()), int(missing.sum())


def compare(*kinds):
    return {kind: compare_kind(kind) for kind in kinds}


def compare_kind(kind):
    found = {}
    for name, case in MOTIONS["upright" if kind == "tiles" else kind].items():
        make = in_tiles if kind == "tiles" else maps
        expected, made = make(*case, "cpu"), make(*case, "cuda")
        found |= {f"{name}, {key}": differences(expected[key], made[key]) for key in expected}
        if kind == "tiles":
            break
    return found


def compare_with_little_memory():
    """A map of several bands, in which each launch computes one group."""
    from turnwright._kernels import cuda

    launches = []

    class Counted:
        def __init__(self, kernel):
            self.kernel = kernel

        def __getitem__(self, sizes):
            launches.append(sizes)
            return self.kernel[sizes]

    (motion, edge), axis = CASES["raked"], np.linspace(0.4, 0.5, 19)
    expected = tw.generate(motion, edge, x=axis, y=axis[:17])
    cuda.BAND_POINTS = 16 * 19
    cuda.cuda.current_context = lambda: SimpleNamespace(get_memory_info=lambda: (1000, 1000))
    ready = Prepared.of(motion, edge, None, distances=grid_distances(axis, axis), most_rings=1000, device="cuda")
    ready.card._lower = Counted(ready.card._lower)
    report = []
    made = ready.fill_grid(axis, axis[:17], progress=lambda *progress: report.append(progress))
    return {"difference": differences(expected.z, made), "launches": len(launches), "progress": report}


def compare_and_with_little_memory(*kinds):
    """The second changes the card for good."""
    return {"equal": compare(*kinds), "memory": compare_with_little_memory()}


class Array:
    """An array in the memory of a card that is not there: a type and a size."""

    def __init__(self, array):
        self.array = array

    def __getitem__(self, key):
        return Array(self.array[key])

    def copy_to_host(self, target):
        assert (target.shape, target.dtype) == (self.array.shape, self.array.dtype)

    @property
    def _numba_type_(self):
        from numba import typeof

        return typeof(self.array)


def compile_for_cards():
    """Return of each kernel and card the target and the numbers of instructions, from the launches of a map.

    Nothing is returned where no compiler for cards is installed.
    """
    from cuda.pathfinder import DynamicLibNotFoundError, load_nvidia_dynamic_lib
    from numba import cuda, typeof, types
    from numba.cuda import dispatcher

    from turnwright._kernels import cuda as card

    try:
        for library in ("nvvm", "nvrtc"):
            load_nvidia_dynamic_lib(library)
    except DynamicLibNotFoundError:
        return {}
    cuda.to_device = lambda array: Array(np.array(array))
    cuda.device_array = lambda shape, dtype=np.float64: Array(np.empty(shape, dtype))
    cuda.current_context = lambda: SimpleNamespace(get_memory_info=lambda: (1e6, 1e6))
    launched = []

    class Recorded:
        def __init__(self, kernel):
            self.kernel = kernel

        def __getitem__(self, _sizes):
            return lambda *arguments: launched.append((self.kernel.py_func, arguments))

    axis = np.linspace(0.4, 0.5, 20)
    for motion, edge in (UPRIGHT["not convex"], CASES["raked"]):  # one upright
        ready = Prepared.of(motion, edge, None, distances=grid_distances(axis, axis), most_rings=400)
        made = card.Card(ready._arguments, ready.cut.y, 0.0)
        made._list, made._lower = Recorded(made._list), Recorded(made._lower)
        made.fill_grid(axis, axis, False, (4, 4), np.ones((2, 2), dtype=bool), np.empty((20, 20)), None)
    # Functions that kernels call are compiled for the card that is there.
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=CARDS[0])
    found = {}
    for function, arguments in launched:
        signature = types.void(*map(typeof, arguments))
        for capability in CARDS:
            code, _ = cuda.compile(function, signature, device=False, cc=capability, output="ptx", abi="numba")
            text = code.decode() if isinstance(code, bytes) else code
            found[f"{function.__name__} {capability[0]}{capability[1]}"] = {
                "target": re.search(r"\.target (\w+)", text)[1],
                "double": len(re.findall(r"\b(?:add|sub|mul|fma|div|sqrt)\.[a-z.]*f64", text)),
                "single": len(re.findall(r"\b(?:add|sub|mul|fma|div|sqrt|cvt)\.[a-z.]*f32", text)),
            }
    return found


if __name__ == "__main__":
    if sys.argv[1] != "compile":
        # The simulator starts a thread for each point of 16 tiles, of the map or not.
        generation.MAX_SIDE = 8
        one_after_the_other()
    work = {"equal": compare, "both": compare_and_with_little_memory, "compile": compile_for_cards}[sys.argv[1]]
    print(json.dumps(work(*sys.argv[2:])))
