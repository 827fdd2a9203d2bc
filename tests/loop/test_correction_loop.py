"""Inject, generate, measure, diagnose, correct, generate: what is left of the form. See `tests.proof.proof_correction`.

Oracle: a job written with the true tool and machine, simulated by the generator. The proof has each cause
alone, a second correction, and a map of 85,000 points.
"""

import numpy as np
import pytest

import turnwright.diagnosis.report as _draws
import turnwright.job.correction as _correct
from tests.proof import proof_correction
from tests.proof.proof_correction import EVERY_MACHINE, EVERY_TOOL, Loop, bump


def test_all_causes_and_a_form_that_none_explains(tmp_path, monkeypatch):
    """The sources and the form have some 155 numbers: of 12 nm, cusps among them, in 14,000 points 1.3 nm."""
    monkeypatch.setattr(_draws, "DRAWS", 50)
    monkeypatch.setattr(_draws, "FULL_CASES", 2)
    monkeypatch.setattr(_correct, "MAX_PREDICTED_POINTS", 4_000)
    monkeypatch.setattr(_correct, "MAX_SIMULATED_PLACES", 200)
    monkeypatch.setattr(proof_correction, "CELLS", 500)
    loop = Loop(tool=EVERY_TOOL, machine=EVERY_MACHINE, form=bump, noise=8e-6, pixels=160, per_rev=360)
    residual, found, _ = loop.go(tmp_path, 1)
    assert residual[0] > 40
    assert residual[1] < 1.0
    assert found.unexplained_rms_nm == pytest.approx(np.hypot(8, 9), rel=0.15)
