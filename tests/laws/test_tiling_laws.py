"""Laws of maps in tiles: how a map is cut, stopped and taken up again leaves no trace in it."""

from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, strategies as st

import turnwright as tw
from laws import examples

TURN = 2 * np.pi
MACHINE = tw.Machine(
    name="test", axes={letter: tw.Axis() for letter in "CXZ"}, spindle_rpm=3000.0, block_rate_hz=1000.0
)
TOOL = tw.Tool(nose_radius=0.2, included=np.deg2rad(100))
K = np.arange(20 * 90 + 1)
ANGLE, X = TURN * K / 90, 0.4 - 0.02 * K / 90
MOTION = tw.Motion(time=1e-3 * K, axes={"C": ANGLE, "X": X, "Z": 1e-3 * X**2 * np.cos(2 * ANGLE)}, machine=MACHINE)
CASES = {"disc": {"radius": 0.35}, "rectangle": {"x": (-0.3, 0.35), "y": (-0.2, 0.3)}}
WHOLE = {}


class EnoughError(Exception):
    """The map was wanted no longer."""


def whole(name, folder):
    if name not in WHOLE:
        made = tw.studies.generate_tiled(MOTION, TOOL, pixel=0.002, store=f"{folder}/whole", tile=4096, **CASES[name])
        WHOLE[name] = made.height_map().z, made.height_map(2).z, made.roughness()
    return WHOLE[name]


@examples(12)
@given(name=st.sampled_from(sorted(CASES)), tile=st.integers(64, 300), stop=st.integers(0, 6))
def test_any_tile_and_any_stop_give_the_same_map_and_roughness(name, tile, stop):
    with TemporaryDirectory() as folder:
        heights, overview, rough = whole(name, folder)

        def report(done, _total):
            if done >= stop:
                raise EnoughError

        asked = {"pixel": 0.002, "store": f"{folder}/map", "tile": tile, **CASES[name]}
        with pytest.raises(EnoughError):
            tw.studies.generate_tiled(MOTION, TOOL, progress=report, **asked) and report(stop, 0)
        made = tw.studies.generate_tiled(MOTION, TOOL, **asked)
        assert np.array_equal(made.height_map().z, heights, equal_nan=True)
        assert np.array_equal(made.height_map(2).z, overview, equal_nan=True)
        found = made.roughness()
        for value in ("sa_nm", "sq_nm", "sz_nm", "sku", "sdq", "sdr"):
            assert getattr(found, value) == pytest.approx(getattr(rough, value), rel=1e-12)
        assert (found.valid, found.missing) == (rough.valid, rough.missing)
