"""Traps for float64: their answers against fractions, that float64 gets them wrong, and what rungs make of them."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction

import numpy as np
import pytest
import reference as ref
from conformance import make_image
from conformance_worlds import Case
from kernel_world import make_scene

from clrast.opencl.device import Device
from clrast.options import AVAILABLE_PRECISIONS
from clrast.study.float64_traps import Trap, bezout, float64_value, traps

PROJECTIONS = ("perspective", "orthographic")
ALL = list(traps(seed=0, count=16))


def kind_of(trap: Trap) -> tuple[str, str]:
    return trap.kind, trap.view.projection


def exact_values(trap: Trap) -> list[Fraction]:
    """V of the trap's edges, by the definition."""
    camera = ref.exact_camera(trap.view.named())
    ray = ref.sample_ray(camera, ref.HALF, ref.HALF)
    points = [ref.vector(row) for row in trap.positions.tolist()]
    return [ref.edge_values((points[k], points[i], points[i]), ray, camera.is_perspective)[0][2] for i, k in trap.edges]


def float64_choice(trap: Trap) -> list[int]:
    """The triangles that have the sample if its edges' signs are those of float64, zeros by the fill rule."""
    spokes = {}
    for edge, (i, k) in enumerate(trap.edges.tolist()):
        value = float64_value(trap, edge)
        if value == 0:
            camera = ref.exact_camera(trap.view.named())
            ray = ref.sample_ray(camera, ref.HALF, ref.HALF)
            a, b = (ref.vector(trap.positions[m].tolist()) for m in (i, k))
            n = ref.cross(ref.subtract(a, ray.e), ref.subtract(b, ray.e))
            if not camera.is_perspective:
                n = ref.cross(ray.d, ref.subtract(b, a))
            value = float(ref.dot(n, ray.tx) or ref.dot(n, ray.ty))
        spokes[(i, k)], spokes[(k, i)] = value > 0, value < 0
    # Of a triangle (0, p, q) all edges have the sign of its volume: those of a fan turn the same way.
    if trap.kind == "near":
        return [0 if spokes[0, 1] == near_side(trap) else 1]
    return [t for t, (h, p, q) in enumerate(trap.triangles.tolist()) if spokes[h, p] and not spokes[h, q]]


def near_side(trap: Trap) -> bool:
    """Whether V > 0 means triangle 0."""
    return (trap.values[0] > 0) == (trap.prim_id == 0)


def test_bezout() -> None:
    for a, b in ((12, 18), (-12, 18), (17, -5), (0, 7), (7, 0), (0, -7), (1 << 70, 3)):
        g, p, q = bezout(a, b)
        assert p * a + q * b == g and g > 0 and a % g == b % g == 0


@pytest.mark.parametrize("trap", ALL, ids=lambda trap: "-".join(kind_of(trap)))
def test_answers_are_those_of_fractions(trap: Trap) -> None:
    prim_id, t, hit_count = ref.visible_triangles(trap.positions, trap.triangles, trap.view.named(), 1, 1)
    assert (prim_id[0, 0], hit_count[0, 0]) == (trap.prim_id, 1) and np.isfinite(t[0, 0])
    values = exact_values(trap)
    assert [ref.sign(v) for v in values] == [ref.sign(v) for v in trap.values]
    if trap.kind == "near":
        lengths = [max(abs(Fraction(float(c))) for c in trap.positions[k]) for k in (0, 1)]
        assert 0 < abs(values[0]) < lengths[0] * lengths[1] / 2**60  # float64 is certain from 2^-51 on
    else:
        assert set(values) == {0}


def test_float64_gets_signs_and_triangles_wrong() -> None:
    """In at least a quarter of each kind, sign and triangle; else the traps catch nothing."""
    wrong_sign, wrong_triangle, all_of = Counter(), Counter(), Counter()
    for trap in ALL:
        found = [float64_value(trap, edge) for edge in range(len(trap.edges))]
        wrong_sign[kind_of(trap)] += [ref.sign(Fraction(v)) for v in found] != [ref.sign(v) for v in trap.values]
        wrong_triangle[kind_of(trap)] += float64_choice(trap) != [trap.prim_id]
        all_of[kind_of(trap)] += 1
    assert len(all_of) == 4
    for kind, count in all_of.items():
        assert wrong_sign[kind] >= count / 4 and wrong_triangle[kind] >= count / 4, (kind, wrong_sign, wrong_triangle)


def fallen_into(device: Device, rung: str, projections: tuple[str, ...]) -> list[Trap]:
    """The traps of these projections that a rung falls into: another id, or not just one hit."""
    found = []
    for trap in ALL:
        if trap.view.projection in projections:
            case = Case("traps", trap.kind, make_scene(trap.positions, trap.triangles), trap.view)
            image = make_image(device, case, {"method": "3dr-binning", "precision": rung}, is_opaque=False)
            if (image.ids[0, 0], image.counts[0, 0]) != (trap.prim_id, 1):
                found.append(trap)
    return found


def check_exact(device: Device, projections: tuple[str, ...]) -> None:
    if "exact" not in AVAILABLE_PRECISIONS:
        pytest.skip("this version has no --precision exact yet")
    assert [kind_of(trap) for trap in fallen_into(device, "exact", projections)] == []


def check_lower(device: Device, rung: str, projections: tuple[str, ...]) -> None:
    """A rung under `exact` falls into traps of each kind."""
    caught = Counter(kind_of(trap) for trap in fallen_into(device, rung, projections))
    assert len(caught) == 2 * len(projections) and min(caught.values()) >= 2, caught


def test_exact_is_right_in_every_trap(first_device: Device) -> None:
    check_exact(first_device, ("perspective",))


def test_midpoint_in_the_place_of_exact_is_caught(first_device: Device) -> None:
    check_lower(first_device, "midpoint", ("perspective",))


@pytest.mark.long
def test_traps_on_every_runtime(device: Device) -> None:
    check_exact(device, PROJECTIONS)
    check_lower(device, "midpoint", PROJECTIONS)


@pytest.mark.long
def test_double_in_the_place_of_exact_is_caught(device: Device) -> None:
    if "double" not in AVAILABLE_PRECISIONS or not device.has_fp64:
        pytest.skip(f"{device.runtime} or this version has no --precision double")
    check_lower(device, "double", PROJECTIONS)
