"""The host's twin of cl/sample_generator.clh where views are not planar: the same float32 operations, the same bits.

Every result of + - * / and sqrt is rounded to float32 at once, as on the device. Studies and tests take samples from
here; renders do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clrast.scene.camera import CameraVectors, Vector

_F = np.float32
TWO_PI = _F(6.28318530717958648)
SINE = tuple(_F(c) for c in (1.57079633, -0.645964098, 0.0796926262, -0.00468175414, 0.000160441185))
COSINE = tuple(_F(c) for c in (1.0, -1.23370055, 0.253669508, -0.0208634807, 0.000919260274, -0.0000252020424))


@dataclass(frozen=True)
class SampleRays:
    """Directions and tangents of samples, each (..., 3) float32; all 0 where there is no sample."""

    d: np.ndarray
    tx: np.ndarray
    ty: np.ndarray


def _polynomial(z: np.ndarray, coefficients: tuple[np.float32, ...]) -> np.ndarray:
    value = np.full_like(z, coefficients[-1])
    for c in coefficients[-2::-1]:
        value = c + z * value
    return value


def _quarter(k: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sine and cosine of k + r quarters of a turn."""
    z = r * r
    s, c = r * _polynomial(z, SINE), _polynomial(z, COSINE)
    quarter = k.astype(np.int64) & 3
    sine, cosine = np.where(quarter & 1, c, s), np.where(quarter & 1, s, c)
    return np.where(quarter & 2, -sine, sine), np.where((quarter + 1) & 2, -cosine, cosine)


def sine_cosine(turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of angles in turns, (...) float32."""
    k = np.floor(_F(4) * turn + _F(0.5))
    return _quarter(k, _F(4) * turn - k)


def sine_cosine_of_ratio(part: np.ndarray, whole: float) -> tuple[np.ndarray, np.ndarray]:
    """Of part / whole turns; part (...) float32."""
    k = np.floor(_F(4) * part / _F(whole) + _F(0.5))
    return _quarter(k, (_F(4) * part - k * _F(whole)) / _F(whole))


def _in_world(camera: CameraVectors, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    def along(vector: Vector, k: int) -> np.float32:
        return _F(vector[k])

    r, u, f = camera.tangent_x, camera.tangent_y, camera.direction
    return np.stack([(a * along(r, k) + b * along(u, k)) + c * along(f, k) for k in range(3)], axis=-1)


def sample_rays(camera: CameraVectors, x: np.ndarray, y: np.ndarray) -> SampleRays:
    """The rays of samples (x, y) of the viewport, pixels, multiples of 1/256; arrays that go together.

    camera : of a projection that is not planar.
    """
    x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    across, down = (x - camera.width / 2).astype(_F), (y - camera.height / 2).astype(_F)
    if camera.projection == "latlong":
        return _latlong(camera, across, down)
    radius = _F(min(camera.width, camera.height) / 2)
    a, b = across / radius, -down / radius
    rays = (_paraboloid if camera.projection == "paraboloid" else _fisheye)(camera, a, b)
    squares = (256 * across).astype(np.int64) ** 2 + (256 * down).astype(np.int64) ** 2
    inside = np.asarray(squares <= int(256 * radius) ** 2)[..., None]
    return SampleRays(*(np.where(inside, v, _F(0)) for v in (rays.d, rays.tx, rays.ty)))


def _paraboloid(camera: CameraVectors, a: np.ndarray, b: np.ndarray) -> SampleRays:
    zero, one = np.zeros_like(a), np.ones_like(a)
    height = _F(0.5) - (a * a + b * b) * _F(0.5)
    return SampleRays(
        _in_world(camera, a, b, height), _in_world(camera, one, zero, -a), _in_world(camera, zero, -one, b)
    )


def _latlong(camera: CameraVectors, across: np.ndarray, down: np.ndarray) -> SampleRays:
    lon_sine, lon_cosine = sine_cosine_of_ratio(across, camera.width)
    lat_sine, lat_cosine = sine_cosine_of_ratio(-down, 2 * camera.height)
    return SampleRays(
        _in_world(camera, lat_cosine * lon_sine, lat_sine, lat_cosine * lon_cosine),
        _in_world(camera, lon_cosine, np.zeros_like(across), -lon_sine),
        _in_world(camera, lat_sine * lon_sine, -lat_cosine, lat_sine * lon_cosine),
    )


def _fisheye(camera: CameraVectors, a: np.ndarray, b: np.ndarray) -> SampleRays:
    rim = _F(camera.rim)
    k, q2 = rim * TWO_PI, a * a + b * b
    q = np.sqrt(q2)
    sine, cosine = sine_cosine(rim * q)
    one = _F(1)
    s = np.where(q > 0, sine / np.where(q > 0, q, one), k)
    g = np.where(q2 > 0, (k * cosine - s) / np.where(q2 > 0, q2, one), _F(0))
    return SampleRays(
        _in_world(camera, a * s, b * s, cosine),
        _in_world(camera, s + a * a * g, a * b * g, -k * s * a),
        _in_world(camera, -a * b * g, -(s + b * b * g), k * s * b),
    )
