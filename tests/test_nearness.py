"""cl/nearness_plane.clh against rational arithmetic."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
from curved_probe import CurvedProbe

from clrast.opencl.device import Device


def test_volumes_are_as_good_as_rounded_once(device: Device, tmp_path: Path) -> None:
    """Against rational arithmetic: u of the value for the last rounding, and for the lost parts, each within 3u of its
    term, eight roundings of u: less than 32 u^2 of the terms. The plain product breaks that where terms cancel.

    Planes: 300 that the eye lies near, others, and 50 of few digits.
    """
    rng, count = np.random.default_rng(8), 400
    eye = np.array([0.3, -1.7, 2.9], dtype=np.float32)
    normals = (rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-6, 6, (count, 1))).astype(np.float32)
    points = (eye + rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-3, 3, (count, 1))).astype(np.float32)
    unit = normals[:300] / np.linalg.norm(normals[:300].astype(np.float64), axis=1, keepdims=True)
    away = ((points[:300] - eye.astype(np.float64)) * unit).sum(axis=1, keepdims=True)
    points[:300] -= (away * unit * (1 - 10.0 ** rng.uniform(-5, -1, (300, 1)))).astype(np.float32)
    points[-50:], normals[-50:] = np.round(points[-50:] * 8) / 8, np.round(normals[-50:])
    found = CurvedProbe(device, tmp_path, "fisheye").volumes(eye, normals, points)
    plain_is_worse = 0
    for n, p, volume in zip(normals, points, found, strict=True):
        terms = [Fraction(float(a)) * (Fraction(float(b)) - Fraction(float(c))) for a, b, c in zip(n, p, eye)]
        exact, size = sum(terms), sum(abs(term) for term in terms)
        bound = abs(exact) * (1 + Fraction(1, 2**20)) / 2**24 + size * 32 / 2**48
        assert abs(Fraction(float(volume)) - exact) <= bound
        r = p - eye
        plain = (n[0] * r[0] + n[1] * r[1]) + n[2] * r[2]
        plain_is_worse += abs(Fraction(float(plain)) - exact) > bound
    assert plain_is_worse > count / 4
