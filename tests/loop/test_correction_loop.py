"""Inject, generate, measure, diagnose, correct, generate: what is left of the form. See `tests.proof.proof_correction`.

Oracle: a job written with the true tool and machine, simulated by the generator. The proof has each cause
alone, a second correction, and a map of 85,000 points.
"""

import numpy as np
import pytest

from tests.proof.proof_correction import EVERY_MACHINE, EVERY_TOOL, Loop, bump


def test_all_causes_and_a_form_that_none_explains(tmp_path):
    """The sources and the form have some 155 numbers: of 15 nm, cusps among them, in 34,000 points 1.0 nm."""
    residual, found, _ = Loop(tool=EVERY_TOOL, machine=EVERY_MACHINE, form=bump, noise=12e-6).go(tmp_path, 1)
    assert residual[0] > 40
    assert residual[1] < 1.0
    assert found.unexplained_rms_nm == pytest.approx(np.hypot(12, 9), rel=0.15)
