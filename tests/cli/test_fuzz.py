"""Mutated inputs, 12 of those that make fuzz gives: each is answered soon, in little memory and in a few letters.

Before the first of them half a minute goes by: what good inputs need is compiled and imported, so it is for make proof.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[1] / "proof" / "fuzz.py"


@pytest.mark.proof
@pytest.mark.skipif(sys.platform != "linux", reason="the limits of the fuzzer are those of Linux")
def test_mutated_inputs_are_answered(tmp_path):
    inputs = ["--inputs", "12", "--seed", "1", "--work", "0.3"]
    command = [sys.executable, str(FUZZ), *inputs, "--workers", "1", "--kept", str(tmp_path)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=1200, env={**os.environ, "PYTHONWARNINGS": ""}
    )
    assert done.returncode == 0, done.stdout + done.stderr
