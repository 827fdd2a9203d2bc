"""A known material is cut, its forces are recorded and learned from, and the file that comes out is that material."""

import numpy as np
import pytest
import tomli_w

from turnwright.cutting import learn_from_file
from turnwright.material import Material


def test_learned_material_is_the_one_that_was_cut(tmp_path):
    glass = Material.load("irg26")
    random = np.random.default_rng(7)
    rate = 5000.0
    time = np.arange(int(1.5 * rate)) / rate
    on = (time > 0.2) & (time < 1.3)
    chip = np.where(on, 100e-6 + 900e-6 * (time - 0.2) / 1.1, 0.0)
    forces = [k * chip * 0.1 for k in glass.coefficients(np.maximum(chip, 1e-9))]
    # The file of the glass says that forces stay what they are at the limit; here they fall to 0.8 of that.
    forces = [np.where(chip > glass.critical.value, 0.8 * one, one) for one in forces]
    table = np.column_stack((time, *forces)) + [0, 0.3, -0.2] * np.ones((time.size, 1))
    table[:, 1:] += 2e-3 * random.normal(size=(time.size, 2))
    header = "time [s],cut [N],thrust [N]"
    np.savetxt(tmp_path / "cut.csv", table, delimiter=",", header=header, comments="", fmt="%.7f")
    experiment = {
        "name": "again", "source": "a simulated cut", "rake": "0 deg",
        "record": {"cutting": "cut", "thrust": "thrust", "drift": 0, "shortest": "20 ms",
                   "block": "2 ms", "guard": "2 ms"},
        "cuts": [{"file": "cut.csv", "width": "0.1 mm", "ramp": ["100 nm", "1 um"]}],
    }  # fmt: skip
    (tmp_path / "experiment.toml").write_text(tomli_w.dumps(experiment))
    found = learn_from_file(tmp_path / "experiment.toml")
    (tmp_path / "again.toml").write_text(tomli_w.dumps(found.table()))
    again = Material.load(tmp_path / "again.toml")
    for mine, theirs in (
        (again.cutting, glass.cutting),
        (again.thrust, glass.thrust),
        (again.critical, glass.critical),
    ):
        assert abs(mine.value - theirs.value) < max(3 * mine.uncertainty, 0.003 * theirs.value)
        assert mine.uncertainty < 0.01 * mine.value
    assert again.brittle_plateau
    assert again.brittle_force == pytest.approx((0.8, 0.8), rel=0.02)
    thick = np.array([700e-6, 900e-6])
    for mine, theirs in zip(again.coefficients(thick), glass.coefficients(thick), strict=True):
        assert mine == pytest.approx(0.8 * theirs, rel=0.02)
