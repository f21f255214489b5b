"""Hostile arguments in the public functions: a finite result, a status or one declared error; no compilation in flight.

In a process of its own, without the annotations' run-time checks, which a user does not have either.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("calls", [500, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_nothing_undeclared_comes_out(calls: int, repository: Path) -> None:
    command = [sys.executable, "-m", "faults.fuzz", "--calls", str(calls), "--seed", str(calls)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(repository / "tests"), str(repository)])}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout, done.stderr[-2000:]
    found = json.loads(done.stdout)
    assert found["wrong"] == {}
    assert found["calls"] == calls
    assert len(found["made"]) == 17
    assert 0.2 * calls < sum(found["refused"].values()) < 0.8 * calls
