#!/usr/bin/env python3
"""Paint the evening sky of dusk.exr: latitude-longitude, 256 by 128, half floats, linear Rec. 709.

    make_sky.py OUT.exr

A gradient from a warm horizon to a blue zenith, dark ground, bands of cloud lit from below, and a low
sun of some thousand times the zenith, three texels wide, at an azimuth of 60 degrees and 9 degrees up.

Needs numpy and OpenEXR's Python module.
"""
import sys

import numpy as np
import OpenEXR

WIDTH, HEIGHT = 256, 128

rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
theta = (rows + 0.5) / HEIGHT * np.pi
# Columns to the right turn clockwise; the middle is +x.
azimuth = (0.5 - (columns + 0.5) / WIDTH) * 2 * np.pi
x, y, z = np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)


def direction(azimuth_degrees, height_degrees):
    a, h = np.radians(azimuth_degrees), np.radians(height_degrees)
    return np.array([np.cos(h) * np.cos(a), np.cos(h) * np.sin(a), np.sin(h)])


def mix(a, b, t):
    return np.asarray(a) * (1 - t[..., None]) + np.asarray(b) * t[..., None]


sun = direction(60, 9)
near_sun = x * sun[0] + y * sun[1] + z * sun[2]
up = np.clip(z, 0, 1)
sky = mix([0.62, 0.42, 0.30], [0.07, 0.13, 0.30], up**0.4)
glow = np.clip(near_sun, 0, 1)
sky += glow[..., None] ** 6 * np.array([0.45, 0.22, 0.08])
sky += glow[..., None] ** 80 * np.array([4.0, 1.9, 0.6])
bands = np.sin(34 * z + 3 * np.sin(2 * azimuth) + 1.5 * np.sin(5 * azimuth + 2))
bands = np.clip(bands - 0.35, 0, 1) * np.exp(-((z - 0.25) / 0.15) ** 2)
sky += bands[..., None] * (0.25 + 0.9 * glow[..., None] ** 2) * np.array([1.0, 0.55, 0.42])
ground = np.array([0.045, 0.04, 0.038]) * (1 + 0.5 * glow[..., None])
image = np.where(z[..., None] > 0, sky, ground)
disk = near_sun > np.cos(np.radians(1.5 * 180 / HEIGHT))
image[disk] += 600 * np.array([1.0, 0.62, 0.3])

channels = {"RGB": image.astype(np.float16)}
header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
OpenEXR.File(header, channels).write(sys.argv[1])
