"""Times the convolution of one 800 x 800 x 3 scene with nine 800 x 800 PSFs in several ways, one after another.

  cached     scipy.fft, real transforms, PSFs' transforms cached (f32 and f64)
  published  full complex FFTs of scene and PSF at 1200 x 1200 for every kernel and channel, as the published
             data simulation does it (f32)
  udc        this project: `cargo bench --bench synth`, in 32 bits and, for a scene with a highlight, in 64

Needs NumPy and SciPy; PyTorch is used for the published way where it is installed.
Usage: python benches/compare_synth.py [threads] [rounds]
"""

import os
import subprocess
import sys
import time

import numpy as np
import scipy.fft

SIDE, GRID, KERNELS = 800, 1200, 9
THREADS = int(sys.argv[1]) if len(sys.argv) > 1 else 2
ROUNDS = int(sys.argv[2]) if len(sys.argv) > 2 else 5

rng = np.random.default_rng(0)
SCENE = rng.random((3, SIDE, SIDE))
PSFS = [psf / psf.sum((1, 2), keepdims=True) for psf in rng.random((KERNELS, 3, SIDE, SIDE))]


def cached(dtype):
    scene = SCENE.astype(dtype)
    otfs = [scipy.fft.rfft2(psf.astype(dtype), (GRID, GRID), workers=THREADS) for psf in PSFS]

    def run():
        spectrum = scipy.fft.rfft2(scene, (GRID, GRID), workers=THREADS)
        for otf in otfs:
            scipy.fft.irfft2(spectrum * otf, (GRID, GRID), workers=THREADS)[:, 200:1000, 200:1000].copy()

    return run


def published():
    pad = [(0, 0), (200, 200), (200, 200)]
    scene = np.pad(SCENE, pad).astype(np.complex64)
    psfs = [np.pad(psf, pad).astype(np.complex64) for psf in PSFS]
    try:
        import torch

        torch.set_num_threads(THREADS)
        scene = torch.from_numpy(scene)
        psfs = [torch.from_numpy(psf) for psf in psfs]
        forward, inverse, shift = torch.fft.fft2, torch.fft.ifft2, torch.fft.ifftshift
    except ImportError:
        forward = lambda x: scipy.fft.fft2(x, workers=THREADS)
        inverse = lambda x: scipy.fft.ifft2(x, workers=THREADS)
        shift = np.fft.ifftshift

    def run():
        for psf in psfs:
            for channel in range(3):
                product = forward(scene[channel]) * forward(psf[channel])
                shift(inverse(product)).real[200:1000, 200:1000]

    return run


def best(run, rounds):
    times = []
    for _ in range(rounds):
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return min(times)


def main():
    ways = [("cached f32", cached(np.float32)), ("cached f64", cached(np.float64)), ("published", published())]
    for name, run in ways:
        print(f"{name:12} {1e3 * best(run, ROUNDS):8.1f} ms", flush=True)
    environment = dict(os.environ, RAYON_NUM_THREADS=str(THREADS))
    subprocess.run(["cargo", "bench", "-q", "--bench", "synth", "--", str(4 * ROUNDS)], env=environment, check=True)


if __name__ == "__main__":
    main()
