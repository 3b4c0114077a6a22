#!/usr/bin/env python3
"""Writes photo.jpg beside this script: the tests' picture as Pillow compresses it (needs pillow and numpy).

4:2:0 chroma at quality 80, as cameras send it.
"""
from pathlib import Path

import numpy as np
from PIL import Image

y, x = np.mgrid[0 : 1 : 75j, 0 : 1 : 100j]
rgb = np.stack([0.3 + 0.4 * x, 0.5 - 0.3 * y, 0.4 + 0.2 * x * y], axis=-1)
rgb[(x - 0.6) ** 2 + (y - 0.4) ** 2 < 0.05] = [0.8, 0.6, 0.5]
image = Image.fromarray((rgb * 255).astype(np.uint8))
image.save(Path(__file__).with_name("photo.jpg"), quality=80, subsampling="4:2:0")
