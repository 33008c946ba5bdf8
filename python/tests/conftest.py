"""What the tests share: the program, a scene with lamps, a PSF."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import udc

PROGRAM = os.environ.get("UDC") or shutil.which("udc")


@pytest.fixture
def cli(tmp_path):
    """Runs the program in a folder of its own; a failure fails the test."""

    def run(*arguments, fails=False):
        assert PROGRAM, "the program is on the path once the wheel is installed; else set UDC to it"
        command = [PROGRAM, *map(str, arguments)]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
        assert (done.returncode != 0) == fails, f"{command}: {done.stderr}"
        return done.stdout + done.stderr

    return run


@pytest.fixture
def at(tmp_path):
    return lambda name: tmp_path / name


@pytest.fixture(scope="session")
def scene():
    """Texture, and two lamps far above white; [H, W, 3] of odd sides."""
    rows, columns = np.mgrid[0:61, 0:83]
    light = [0.2 + 0.15 * np.sin(rows / (4 + i)) * np.cos(columns / (5 + i)) for i in range(3)]
    scene = np.stack(light, axis=-1).astype(np.float32)
    scene[20:22, 30:33] = [60, 50, 40]
    scene[45, 60] = 30
    return scene


@pytest.fixture(scope="session")
def psf():
    return udc.simulate_psf(random=7, size=33)


@pytest.fixture(scope="session")
def repository():
    return Path(__file__).resolve().parents[2]


def planar(image):
    """The same values in planar memory."""
    return np.moveaxis(np.ascontiguousarray(np.moveaxis(image, -1, 0)), 0, -1)


def same(a, b):
    """Whether two arrays are equal to the bit."""
    a, b = np.ascontiguousarray(a), np.ascontiguousarray(b)
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
