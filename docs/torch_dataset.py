"""A PyTorch data set that degrades clean scenes on the fly, timed against doing the same in torch.

python docs/torch_dataset.py [SIDE [COUNT]]

Scenes are random here; replace `scenes` by views of your own, float32 [H, W, 3] of linear light.
"""

import sys
import time

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

import udc


class DegradedScenes(Dataset):
    """Pairs (degraded, ground truth) and the code of the kernel: tone-mapped float32 [3, H, W] twice, and [b].

    An epoch sees each scene through another kernel of the bank, and with other noise.
    """

    def __init__(self, scenes, bank, alpha=0.25, **formation):
        self.scenes, self.alpha, self.epoch = scenes, alpha, 0
        self.codes = torch.from_numpy(bank.codes)
        self.degrader = udc.Degrader(bank=bank, **formation)

    def __len__(self):
        return len(self.scenes)

    def __getitem__(self, index):
        scene = self.scenes[index]
        kernel = (index + self.epoch) % len(self.degrader)
        degraded = self.degrader(scene, kernel, name=f"{index}-{self.epoch}")
        return self.tone_mapped(degraded), self.tone_mapped(self.degrader.ground_truth(scene)), self.codes[kernel]

    def tone_mapped(self, image):
        # Planar memory already: no copy is made here.
        light = torch.from_numpy(np.moveaxis(image, -1, 0))
        return light / (light + self.alpha)


def start_worker(_):
    """Workers share the cores: each computes on one."""
    udc.set_threads(1)


def degrade_in_torch(scene, psf, x_max):
    """The same in torch, by transforms of the full size as published code does it."""
    height, width = scene.shape[-2] + psf.shape[-2] - 1, scene.shape[-1] + psf.shape[-1] - 1
    product = torch.fft.rfft2(scene, s=(height, width)) * torch.fft.rfft2(psf, s=(height, width))
    full = torch.fft.irfft2(product, s=(height, width))
    top, left = psf.shape[-2] // 2, psf.shape[-1] // 2
    return full[..., top : top + scene.shape[-2], left : left + scene.shape[-1]].clamp(0, x_max)


def main():
    side, count = (int(argument) for argument in (sys.argv[1:] + ["512", "16"][len(sys.argv) - 1 :]))
    rng = np.random.default_rng(0)
    scenes = [rng.gamma(0.3, 1.0, (side, side, 3)).astype(np.float32) for _ in range(count)]
    psf = udc.simulate_psf(random=7, size=side // 2 + 1)
    bank = udc.codes(psf, angles=[-3, 0, 3], dim=2)
    dataset = DegradedScenes(scenes, bank, x_max=500)
    for degraded, ground_truth, codes in DataLoader(dataset, batch_size=4, num_workers=2, worker_init_fn=start_worker):
        assert degraded.shape == ground_truth.shape and codes.shape[1] == 2

    planar = [np.ascontiguousarray(np.moveaxis(scene, -1, 0)) for scene in scenes]
    kernels = torch.from_numpy(np.ascontiguousarray(np.moveaxis(bank.psfs, -1, 1)))
    degrader = dataset.degrader
    ours = [degrader(np.moveaxis(scene, 0, -1), 0) for scene in planar]  # the first round prepares the kernel
    theirs = [degrade_in_torch(torch.from_numpy(scene), kernels[0], 500.0) for scene in planar]
    largest = max(np.abs(np.moveaxis(a, -1, 0) - b.numpy()).max() for a, b in zip(ours, theirs))

    def seconds(work):
        start = time.perf_counter()
        for scene in planar:
            work(scene)
        return (time.perf_counter() - start) / count

    own = seconds(lambda scene: degrader(np.moveaxis(scene, 0, -1), 0))
    torch_own = seconds(lambda scene: degrade_in_torch(torch.from_numpy(scene), kernels[0], 500.0))
    print(f"{side} × {side} through {psf.shape[0]} × {psf.shape[1]}: udc {1e3 * own:.1f} ms, torch {1e3 * torch_own:.1f} ms")
    print(f"largest difference {largest:.2e}")


if __name__ == "__main__":
    main()
