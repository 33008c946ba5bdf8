"""Degrades a scene by a panel and restores it, in ten lines: python docs/degrade_and_restore.py [FOLDER]"""

import sys
from pathlib import Path

import numpy as np
import udc

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
rows, columns = np.mgrid[0:160, 0:240]
scene = np.stack([0.2 + 0.15 * np.sin(rows / (4 + i)) * np.cos(columns / 7) for i in range(3)], axis=-1).astype(np.float32)
scene[40:43, 60:63] = scene[100:102, 180:184] = [60, 50, 40]  # two lamps, far brighter than white
psf = udc.simulate_psf(random=7, size=129)
capture, info = udc.degrade(scene, psf, x_max=16, noise="gaussian:0.002", return_info=True)
restored, info = udc.restore(capture, psf, info=info, return_info=True)
udc.write(folder / "capture.png", udc.finish(capture, info=info), overwrite=True)
udc.write(folder / "restored.png", udc.finish(restored, info=info), overwrite=True)
for name, image in [("capture", capture), ("restored", restored)]:
    print(f"{name}: {udc.psnr(image, scene, x_max=16):.2f} dB, SSIM {udc.ssim(image, scene, x_max=16):.4f}")
