"""cl/wide_integers.clh against Python's integers: every length and sign, carries through all limbs, every float."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features

LIMBS = 30
"""Room for an operand: determinants have up to three coordinates' worth, and comparisons multiply two of them."""
COORDINATE_LIMBS = 10
TERMS = 4
RANDOM_CASES = 400

PROBE = """
#include "vector.clh"
#include "wide_integers.clh"

// Writes: products, sums, signs. Work item: one case. Local memory: 0 bytes.
kernel void probe_integers(
    uint count,
    global const uint *restrict a,        // [count][30] limbs, the lowest first
    global const uint *restrict b,        // [count][30]
    global const uint *restrict lengths,  // [count][3] limbs of a, of b; 1 to subtract, 0 to add
    global uint *restrict products,       // [count][60] a * b
    global uint *restrict sums,           // [count][30] a + b or a - b, where b is not longer
    global int *restrict signs)           // [count] of a
{
  const uint k = get_global_id(0);
  if (k >= count) return;
  uint x[30], y[30], product[60];
  for (uint i = 0; i < 30; ++i) {
    x[i] = a[30 * k + i];
    y[i] = b[30 * k + i];
  }
  const int x_length = (int)lengths[3 * k], y_length = (int)lengths[3 * k + 1];
  signs[k] = wide_sign(x, x_length);
  wide_multiply(product, x, x_length, y, y_length);
  for (int i = 0; i < x_length + y_length; ++i) products[60 * k + i] = product[i];
  if (y_length <= x_length) wide_accumulate(x, x_length, y, y_length, lengths[3 * k + 2] != 0);
  for (int i = 0; i < x_length; ++i) sums[30 * k + i] = x[i];
}

// Writes: sums, ranges. Work item: one case. Local memory: 0 bytes.
kernel void probe_floats(
    uint count,
    global const float *restrict values,  // [count][4]
    global const int *restrict factors,   // [count][4]
    global const int *restrict places,    // [count][2] unit; limbs of the sum
    global uint *restrict sums,           // [count][30] the sum of factor * value / 2^unit
    global int *restrict ranges)          // [count][2] low and high of widen_range
{
  const uint k = get_global_id(0);
  if (k >= count) return;
  uint out[30];
  const int length = places[2 * k + 1];
  BitRange range = {1000, -1000};
  wide_clear(out, length);
  for (uint i = 0; i < 4; ++i) {
    widen_range(&range, values[4 * k + i]);
    wide_add_float(out, length, values[4 * k + i], places[2 * k], factors[4 * k + i]);
  }
  for (int i = 0; i < length; ++i) sums[30 * k + i] = out[i];
  ranges[2 * k] = range.low;
  ranges[2 * k + 1] = range.high;
}
"""


@pytest.fixture
def probe(device: Device, tmp_path: Path):
    """run(kernel, count, outputs, **arrays): outputs are name -> (dtype, shape)."""
    shutil.copy(kernels.kernel_folder() / "vector.clh", tmp_path)
    shutil.copy(kernels.kernel_folder() / "wide_integers.clh", tmp_path)
    (tmp_path / "probe_wide.cl").write_text(PROBE)
    program = kernels.build(device, "probe_wide.cl", Features(device.vector_width), tmp_path)

    def run(kernel: str, count: int, outputs: dict[str, tuple[type, tuple]], **arrays: np.ndarray) -> list[np.ndarray]:
        given = {name: buffers.upload(device, np.ascontiguousarray(array)) for name, array in arrays.items()}
        made = {name: buffers.create(device, 4 * int(np.prod(shape))) for name, (_, shape) in outputs.items()}
        program.launch(kernel, count, 1, count=count, **given, **made)
        return [buffers.download(device, made[name], *outputs[name]) for name in outputs]

    return run


def to_limbs(value: int, length: int) -> list[int]:
    """Two's complement, padded with rubbish that nobody may read."""
    assert -(1 << 32 * length - 1) <= value < 1 << 32 * length - 1
    bits = value & (1 << 32 * length) - 1
    return [bits >> 32 * i & 0xFFFFFFFF for i in range(length)] + [0xDEADBEEF] * (LIMBS - length)


def to_integer(limbs: np.ndarray) -> int:
    return int.from_bytes(np.ascontiguousarray(limbs).astype("<u4").tobytes(), "little", signed=True)


def wrapped(value: int, length: int) -> int:
    """What is left of a value in so many limbs."""
    half = 1 << 32 * length - 1
    return (value + half) % (2 * half) - half


def extremes(length: int) -> list[int]:
    """Ends of the range, all-ones, and numbers whose neighbours carry through every limb."""
    top = 1 << 32 * length - 1
    middle = 1 << 32 * (length // 2)
    return [0, 1, -1, top - 1, -top, top - 2, 1 - top, middle, -middle, middle - 1, 0xFFFFFFFF % top, -0x80000000 % top]


def random_integer(rng: np.random.Generator, length: int) -> int:
    """Any size under the length; a third have long runs of ones or zeros."""
    bits = int(rng.integers(0, 32 * length))
    value = int.from_bytes(rng.bytes(4 * length), "little") & (1 << bits) - 1
    if rng.random() < 1 / 3:
        value = (1 << bits) - (1 << int(rng.integers(0, bits + 1)))
    return -value if rng.random() < 0.5 else value


def integer_cases() -> list[tuple[int, int, int, int, int]]:
    """(a, its limbs, b, its limbs, whether to subtract)."""
    rng = np.random.default_rng(1)
    cases = []
    for length in (*range(1, COORDINATE_LIMBS + 1), 20, 30):
        ends = extremes(length)
        cases += [(a, length, b, length, k % 2) for k, a in enumerate(ends) for b in ends[k % 3 :: 3]]
        short = 1 + length // 2
        cases += [(a, length, b, short, k % 2) for k, a in enumerate(ends) for b in extremes(short)[k % 4 :: 4]]
    for k in range(RANDOM_CASES):
        long = LIMBS if k % 4 == 0 else COORDINATE_LIMBS
        of_a, of_b = (int(n) for n in rng.integers(1, long + 1, size=2))
        cases.append((random_integer(rng, of_a), of_a, random_integer(rng, of_b), of_b, int(rng.integers(0, 2))))
    return cases


@pytest.mark.small
def test_products_sums_and_signs(device: Device, probe) -> None:
    cases = integer_cases()
    if device.runtime == "oclgrind":
        cases = cases[::17]
    count = len(cases)
    products, sums, signs = probe(
        "probe_integers",
        count,
        {"products": (np.uint32, (count, 60)), "sums": (np.uint32, (count, 30)), "signs": (np.int32, (count,))},
        a=np.array([to_limbs(a, n) for a, n, _, _, _ in cases], dtype=np.uint32),
        b=np.array([to_limbs(b, n) for _, _, b, n, _ in cases], dtype=np.uint32),
        lengths=np.array([(n, m, minus) for _, n, _, m, minus in cases], dtype=np.uint32),
    )
    sum_count = 0
    for k, (a, of_a, b, of_b, minus) in enumerate(cases):
        assert signs[k] == (a > 0) - (a < 0), (a, of_a)
        assert to_integer(products[k, : of_a + of_b]) == a * b, (a, of_a, b, of_b)
        if of_b <= of_a:
            assert to_integer(sums[k, :of_a]) == wrapped(a - b if minus else a + b, of_a), (a, of_a, b, of_b, minus)
            sum_count += 1
    assert sum_count > count // 2


def float_cases() -> list[tuple[list[float], list[int]]]:
    """Four values and their factors: denormals, the largest, zeros of both signs, any bits; factors up to 2^24."""
    rng = np.random.default_rng(2)
    largest, smallest = float(np.finfo(np.float32).max), 2.0**-149
    edge = [0.0, -0.0, smallest, -smallest, 2.0**-126, 2.0**-126 - smallest, largest, -largest, 1.0, 1.0 - 2.0**-24]
    cases = [([a, b, a, -b], [2**24, -(2**24), 1, 256]) for a in edge for b in edge]
    cases += [([largest] * 4, [2**24] * 4), ([-largest] * 4, [2**24] * 4), ([smallest] * 4, [-(2**24)] * 4)]
    for _ in range(RANDOM_CASES):
        bits = rng.integers(0, 2**32, size=TERMS, dtype=np.uint32)
        exponents = rng.integers(0, 255, size=TERMS).astype(np.uint32)
        if rng.random() < 0.5:  # near one another, so that sums cancel
            exponents = np.clip(exponents[0] + rng.integers(0, 30, size=TERMS), 0, 254).astype(np.uint32)
        values = (bits & 0x807FFFFF | exponents << 23).view(np.float32)
        cases.append(([float(v) for v in values], [int(f) for f in rng.integers(-(2**24), 2**24 + 1, size=TERMS)]))
    return cases


def multiple(value: float, unit: int) -> int:
    """value / 2^unit, a whole number."""
    numerator, denominator = value.as_integer_ratio()
    numerator, rest = divmod(numerator << max(-unit, 0), denominator << max(unit, 0))
    assert rest == 0
    return numerator


def bit_range(values: list[float]) -> tuple[int, int]:
    """The exponent of the lowest bit of any value, and of the power of two above all sizes."""
    whole = [abs(multiple(v, -149)) for v in values if v]
    return min((n & -n).bit_length() - 1 for n in whole) - 149, max(n.bit_length() for n in whole) - 149


@pytest.mark.small
def test_sums_of_floats_times_integers(device: Device, probe) -> None:
    """In units of the lowest bit of any of them, in as many limbs as the definition of the length grants."""
    cases = [case for case in float_cases() if any(case[0])]
    if device.runtime == "oclgrind":
        cases = cases[::17]
    count, ranges = len(cases), [bit_range(values) for values, _ in cases]
    # 26 bits for a factor's size and four terms, 1 for the sign.
    lengths = [-(-(high - low + 27) // 32) for low, high in ranges]
    assert max(lengths) == COORDINATE_LIMBS
    assert device.runtime == "oclgrind" or set(lengths) == set(range(1, COORDINATE_LIMBS + 1))
    sums, found = probe(
        "probe_floats",
        count,
        {"sums": (np.uint32, (count, 30)), "ranges": (np.int32, (count, 2))},
        values=np.array([values for values, _ in cases], dtype=np.float32),
        factors=np.array([factors for _, factors in cases], dtype=np.int32),
        places=np.array([(low, n) for (low, _), n in zip(ranges, lengths, strict=True)], dtype=np.int32),
    )
    for k, (values, factors) in enumerate(cases):
        low, high = ranges[k]
        assert tuple(found[k]) == (low, high), values
        expected = sum(f * multiple(v, low) for v, f in zip(values, factors, strict=True))
        assert to_integer(sums[k, : lengths[k]]) == expected, (values, factors)
