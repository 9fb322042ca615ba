"""Spots of light in an image, each with its uncertainty.

Runs on a simulated picture; for your own give a path or an array: armsight.find_spots("left.png").
"""

import numpy as np

import armsight

frame = next(iter(armsight.simulate("webcam-cell", frames=1)))
spots = armsight.find_spots(frame.left)

brightest = np.argsort(-spots.peak)[:3]
for (u, v), covariance in zip(spots.uv_px[brightest], spots.covariance_px2[brightest], strict=True):
    su, sv = np.sqrt(np.diag(covariance))
    print(f"u = {u:8.3f} +- {su:.3f} px   v = {v:8.3f} +- {sv:.3f} px")
