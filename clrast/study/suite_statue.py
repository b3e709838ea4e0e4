"""A seated figure on a lotus as one closed skin of many small triangles, as scanners make them.

The figure is a field, negative inside: rounded bodies that melt into one another, with folds, curls and a worn
surface on top. Its zero set is meshed by surface nets (Gibson, 'Constrained Elastic Surface Nets', 1998, without the
relaxation): a vertex in each cell of a lattice that the surface passes, a quad round each edge of it.
Only + - * / sqrt, floor and comparisons, so that the same bits come out everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from clrast.scene.model import Camera
from clrast.study.suite_meshes import Mesh, Part, Plan, Vector, detail, paint, sun

CELLS = 428
"""Of the lattice along the height of the figure in the scene `tiny`, at scale 1."""

HEIGHT = 1.84
"""Metres from the ground to the tip."""

BLOCK = 4
"""Cells along the side of a block; the field is evaluated in blocks that the surface passes."""

CHUNK = 1 << 15
"""Points whose field is evaluated at once: what fits the cache."""

LOW, HIGH = (-0.82, -0.04, -0.76), (0.82, 1.90, 0.76)
"""The lattice's box: the surface lies inside."""

NOISE_SIDE = 16
Field = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def statue(cells: int, seed: int) -> Mesh:
    """The figure, standing on y = 0 and looking towards +z.

    cells : cells of the lattice along the height, at least 24; triangles grow with its square
    """
    return surface_net(_figure(seed), LOW, HIGH, (HIGH[1] - LOW[1]) / max(24, cells))


def tiny_plan(scale: float, seed: int) -> Plan:
    """The figure alone, seen whole from outside, and from the hollow of its chest."""
    part = Part("figure", "sandstone", smooth=True)
    part.add(statue(detail(CELLS, scale, 24), seed))
    return Plan(
        parts=(part,),
        materials=(paint("sandstone", 0.58, 0.43, 0.27, roughness=0.7),),
        lights=(
            sun("key", 2.3, 2.05, 1.7, -0.9, -0.8, -0.5),
            sun("fill", 0.22, 0.28, 0.40, 0.9, -0.2, -0.5),
            sun("rim", 0.7, 0.75, 0.9, 0.5, -0.4, 0.9),
            sun("floor", 0.20, 0.15, 0.11, 0.0, 1.0, -0.2),
        ),
        cameras=(
            Camera("outside", eye=(0.9, 1.35, 3.3), look_at=(0.0, 0.86, 0.0), fov=36.0),
            Camera("inside", eye=(0.0, 0.95, 0.02), look_at=(0.25, 0.45, 0.15), fov=75.0),
        ),
    )


# --- the field -------------------------------------------------------------------------------------


def _ellipsoid(x: np.ndarray, y: np.ndarray, z: np.ndarray, center: Vector, radii: Vector) -> np.ndarray:
    """About the distance: exact on the surface, in value and in slope."""
    a, b, c = ((p - q) / r for p, q, r in zip((x, y, z), center, radii, strict=True))
    k0 = np.sqrt(a * a + b * b + c * c)
    a, b, c = a / radii[0], b / radii[1], c / radii[2]
    return k0 * (k0 - 1.0) / (np.sqrt(a * a + b * b + c * c) + 1e-9)


def _limb(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, start: Vector, end: Vector, radius: float, end_radius: float
) -> np.ndarray:
    """A straight limb with round ends whose radius changes along it."""
    u, v, w = (q - p for p, q in zip(start, end, strict=True))
    a, b, c = x - start[0], y - start[1], z - start[2]
    t = np.minimum(np.maximum((a * u + b * v + c * w) / (u * u + v * v + w * w), 0.0), 1.0)
    a, b, c = a - t * u, b - t * v, c - t * w
    return np.sqrt(a * a + b * b + c * c) - (radius + t * (end_radius - radius))


def _melt(fields: Sequence[np.ndarray], width: float) -> np.ndarray:
    """The union of bodies, with fillets of about this width where they meet."""
    made = fields[0]
    for other in fields[1:]:
        h = np.maximum(width - np.abs(made - other), 0.0)
        made = np.minimum(made, other) - h * h / (4.0 * width)
    return made


def _fold(x: np.ndarray, z: np.ndarray, halvings: int) -> tuple[np.ndarray, np.ndarray]:
    """A point's mirror image in the sector along +x, of 2 * 2^halvings equal ones round the y axis, half of it."""
    x, z = np.abs(x), np.abs(z)
    for k in range(1, halvings):
        angle = math.pi / 2 ** (k + 1)
        a, b = math.sin(angle), -math.cos(angle)  # mirrored in the line at this angle
        h = 2.0 * np.minimum(a * x + b * z, 0.0)
        x, z = x - h * a, z - h * b
    return x, z


def _pedestal(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """A stepped plinth under a lotus of two rows of petals, with a string of beads."""
    rho = np.sqrt(x * x + z * z)
    plinth = np.maximum(rho - 0.64, np.abs(y - 0.045) - 0.045)
    step = np.maximum(rho - 0.56, np.abs(y - 0.07) - 0.07)
    core = np.maximum(rho - 0.50, np.abs(y - 0.19) - 0.17)
    a, b = _fold(x, z, 4)
    upper = _ellipsoid(a, y, b, (0.50, 0.275, 0.0), (0.115, 0.095, 0.115))
    lower = _ellipsoid(a, y, b, (0.53, 0.165, 0.0), (0.105, 0.06, 0.12))
    tip = _ellipsoid(a, y, b, (0.572, 0.325, 0.0), (0.034, 0.055, 0.055))
    p, q = _fold(x, z, 6)
    p, q = p - 0.60, q
    bead = np.sqrt(p * p + (y - 0.095) * (y - 0.095) + q * q) - 0.021
    return _melt([np.minimum(plinth, step), core, lower, upper, tip, bead], 0.02)


def _face(s: np.ndarray, y: np.ndarray, z: np.ndarray) -> list[np.ndarray]:
    """What stands out on the head; s = |x|."""
    return [
        _limb(s, y, z, (0.0, 1.55, 0.185), (0.0, 1.47, 0.215), 0.012, 0.022),
        _limb(s, y, z, (0.018, 1.555, 0.185), (0.10, 1.56, 0.150), 0.010, 0.006),
        _ellipsoid(s, y, z, (0.058, 1.522, 0.170), (0.036, 0.017, 0.022)),
        _ellipsoid(s, y, z, (0.0, 1.420, 0.186), (0.046, 0.010, 0.018)),
        _ellipsoid(s, y, z, (0.0, 1.400, 0.182), (0.036, 0.011, 0.018)),
        _ellipsoid(s, y, z, (0.0, 1.345, 0.150), (0.050, 0.035, 0.040)),
        _limb(s, y, z, (0.158, 1.56, 0.01), (0.150, 1.36, 0.03), 0.028, 0.024),
    ]


def _body(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The clothed body and the bare head with the hands, two fields."""
    s = np.abs(x)
    trunk = _melt([
        _ellipsoid(s, y, z, (0.0, 0.50, 0.0), (0.36, 0.19, 0.28)),
        _ellipsoid(s, y, z, (0.0, 0.74, 0.05), (0.27, 0.26, 0.21)),
        _ellipsoid(s, y, z, (0.0, 1.02, 0.02), (0.29, 0.25, 0.18)),
        _limb(s, y, z, (0.0, 1.17, -0.01), (0.30, 1.14, -0.01), 0.11, 0.10),
        _limb(s, y, z, (0.36, 1.13, -0.01), (0.47, 0.80, 0.03), 0.095, 0.085),
        _limb(s, y, z, (0.47, 0.80, 0.03), (0.15, 0.63, 0.32), 0.088, 0.062),
        _limb(s, y, z, (0.15, 0.49, 0.02), (0.54, 0.44, 0.20), 0.150, 0.115),
    ], 0.06)  # fmt: skip
    shins = _melt([
        _limb(x, y, z, (0.54, 0.43, 0.22), (-0.16, 0.42, 0.43), 0.105, 0.075),
        _limb(x, y, z, (-0.54, 0.43, 0.22), (0.12, 0.50, 0.38), 0.105, 0.065),
    ], 0.02)  # fmt: skip
    bare = _melt([
        _limb(s, y, z, (0.0, 1.20, 0.0), (0.0, 1.38, 0.02), 0.10, 0.085),
        _ellipsoid(s, y, z, (0.0, 1.505, 0.03), (0.158, 0.195, 0.170)),
        *_face(s, y, z),
    ], 0.022)  # fmt: skip
    hands = _melt([
        _ellipsoid(x, y, z, (0.05, 0.585, 0.37), (0.15, 0.040, 0.085)),
        _ellipsoid(x, y, z, (-0.05, 0.635, 0.36), (0.14, 0.035, 0.080)),
        _limb(s, y, z, (0.10, 0.66, 0.38), (0.01, 0.72, 0.38), 0.020, 0.016),
    ], 0.02)  # fmt: skip
    return _melt([trunk, shins], 0.04), np.minimum(bare, hands)


def _hair(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """A cap with a knot, set with round curls."""
    cap = _ellipsoid(x, y, z, (0.0, 1.545, -0.005), (0.168, 0.180, 0.172))
    front = 0.055 + z * 0.55 - (y - 1.545)  # the hairline: above it and behind
    knot = _ellipsoid(x, y, z, (0.0, 1.715, -0.01), (0.085, 0.075, 0.085))
    tip = _ellipsoid(x, y, z, (0.0, 1.80, -0.01), (0.028, 0.035, 0.028))
    made = _melt([np.maximum(cap, front), knot], 0.02)
    q = [p / 0.042 - np.floor(p / 0.042) - 0.5 for p in (x, y, z)]
    curl = np.maximum(1.0 - 3.0 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2]), 0.0)
    return _melt([made - 0.013 * curl * curl, tip], 0.012)


def _pleats(w: np.ndarray) -> np.ndarray:
    """A smooth wave from 0 to 1 of period 1."""
    f = w - np.floor(w)
    g = 4.0 * f * (1.0 - f)
    return g * g * (3.0 - 2.0 * g)


def _noise(table: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Smooth noise of -1 to 1 between the lattice values of `table`, (NOISE_SIDE,) * 3, which repeats."""
    floors = [np.floor(p) for p in (x, y, z)]
    low = [f.astype(np.int64) % NOISE_SIDE for f in floors]
    high = [(k + 1) % NOISE_SIDE for k in low]
    t = [p - f for p, f in zip((x, y, z), floors, strict=True)]
    u, v, w = (s * s * (3.0 - 2.0 * s) for s in t)
    planes = []
    for i in (low[0], high[0]):
        rows = []
        for j in (low[1], high[1]):
            a, b = table[i, j, low[2]], table[i, j, high[2]]
            rows.append(a + w * (b - a))
        planes.append(rows[0] + v * (rows[1] - rows[0]))
    return planes[0] + u * (planes[1] - planes[0])


def _figure(seed: int) -> Field:
    random = np.random.Generator(np.random.PCG64(seed))
    table = 2.0 * random.random((NOISE_SIDE,) * 3) - 1.0

    def field(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        clothed, bare = _body(x, y, z)
        rough = _noise(table, 5.0 * x, 5.0 * y, 5.0 * z)
        slant = 13.0 * y + 9.0 * x * (y - 0.3) + 5.0 * z * z + 0.8 * rough
        clothed = clothed - 0.011 * _pleats(slant)
        made = _melt([clothed, bare, _hair(x, y, z)], 0.014)
        made = _melt([made, _pedestal(x, y, z)], 0.012)
        worn = _noise(table, 23.0 * x, 23.0 * y, 23.0 * z) + 0.4 * _noise(table, 71.0 * x, 71.0 * y, 71.0 * z)
        return made - 0.0022 * worn

    return field


# --- the mesh --------------------------------------------------------------------------------------


def surface_net(field: Field, low: Vector, high: Vector, step: float) -> Mesh:
    """The closed mesh of the zero set of `field` inside a box, outwards where the field is positive.

    field : of x, y, z, each (n,) float64, gives (n,) float64; positive at the border of the box
    step : side of a cell, in the units of the box
    """
    shape = tuple(int(math.ceil((b - a) / (step * BLOCK))) for a, b in zip(low, high, strict=True))
    lattice = _Lattice(field, low, step, shape)
    blocks, values = lattice.blocks_on_surface()
    return lattice.mesh(blocks, values)


class _Lattice:
    """shape : blocks along each axis. Points, cells and blocks are numbered with z fastest."""

    def __init__(self, field: Field, low: Vector, step: float, shape: tuple[int, ...]) -> None:
        self.field, self.low, self.step, self.shape = field, low, step, shape
        self.cells = tuple(BLOCK * n for n in shape)

    def evaluate(self, i: np.ndarray, j: np.ndarray, k: np.ndarray) -> np.ndarray:
        """The field at lattice points (all of one shape)."""
        flat = [index.reshape(-1) for index in (i, j, k)]
        made = np.zeros(len(flat[0]), np.float64)
        for start in range(0, len(made), CHUNK):
            piece = slice(start, start + CHUNK)
            made[piece] = self.field(*(a + self.step * f[piece] for a, f in zip(self.low, flat, strict=True)))
        return made.reshape(i.shape)

    def split(self, numbers: np.ndarray, shape: tuple[int, ...]) -> list[np.ndarray]:
        """Three indices of a number."""
        return [numbers // (shape[1] * shape[2]), numbers // shape[2] % shape[1], numbers % shape[2]]

    def blocks_on_surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the blocks that the surface passes, sorted, and (block_count, 5, 5, 5) float64 of the field.

        It starts from blocks whose corners differ in sign and grows across every side that the surface passes, so
        that no crossed edge lacks one of its four cells.
        """
        corners = np.meshgrid(*(BLOCK * np.arange(n + 1) for n in self.shape), indexing="ij")
        inside = self.evaluate(*corners) < 0.0
        count = sum(
            inside[a : a + self.shape[0], b : b + self.shape[1], c : c + self.shape[2]].astype(np.int64)
            for a in (0, 1) for b in (0, 1) for c in (0, 1)
        )  # fmt: skip
        fresh = np.flatnonzero((count > 0) & (count < 8))
        steps = np.meshgrid(*(np.arange(BLOCK + 1),) * 3, indexing="ij")
        known = np.zeros(self.shape[0] * self.shape[1] * self.shape[2], bool)
        found: list[np.ndarray] = []
        values: list[np.ndarray] = []
        while len(fresh):
            known[fresh] = True
            first = [BLOCK * index[:, None, None, None] for index in self.split(fresh, self.shape)]
            field = self.evaluate(*(a + b for a, b in zip(first, steps, strict=True)))
            found.append(fresh)
            values.append(field)
            fresh = self._beyond(fresh, field < 0.0)
            fresh = fresh[~known[fresh]]
        blocks = np.concatenate(found)
        order = np.argsort(blocks, kind="stable")
        return blocks[order], np.concatenate(values)[order]

    def _beyond(self, blocks: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """Blocks on the other side of the sides that the surface passes."""
        strides = (self.shape[1] * self.shape[2], self.shape[2], 1)
        reached = []
        for axis in range(3):
            for end, sign in ((0, -1), (BLOCK, 1)):
                side = np.take(inside, end, axis=axis + 1).reshape(len(blocks), -1)
                crossed = side.any(axis=1) & ~side.all(axis=1)
                reached.append(blocks[crossed] + sign * strides[axis])
        return np.unique(np.concatenate(reached))

    def mesh(self, blocks: np.ndarray, values: np.ndarray) -> Mesh:
        corners = [
            values[:, a : a + BLOCK, b : b + BLOCK, c : c + BLOCK] for a in (0, 1) for b in (0, 1) for c in (0, 1)
        ]
        inside = np.zeros(corners[0].shape, np.int8)
        for corner in corners:
            inside += corner < 0.0
        block, i, j, k = np.nonzero((inside > 0) & (inside < 8))
        field = np.stack([corner[block, i, j, k] for corner in corners], axis=1)
        cell = [BLOCK * b + c for b, c in zip(self.split(blocks[block], self.shape), (i, j, k), strict=True)]
        numbers = (cell[0] * self.cells[1] + cell[1]) * self.cells[2] + cell[2]
        order = np.argsort(numbers, kind="stable")
        numbers, field = numbers[order], field[order]
        positions = self._vertices([c[order] for c in cell], field)
        return Mesh(positions, _halve(positions, self._quads(numbers, field)))

    def _vertices(self, cell: list[np.ndarray], field: np.ndarray) -> np.ndarray:
        """A vertex for each cell: the mean of the points where the surface crosses its edges.

        field : (cell_count, 8) float64, corner 4a + 2b + c at offset (a, b, c)
        """
        total = np.zeros((len(field), 3), np.float64)
        crossings = np.zeros(len(field), np.float64)
        for axis, stride in enumerate((4, 2, 1)):
            for start in (corner for corner in range(8) if not corner & stride):
                a, b = field[:, start], field[:, start + stride]
                crossed = (a < 0.0) != (b < 0.0)
                t = np.where(crossed, a / np.where(crossed, a - b, 1.0), 0.0)
                for other in range(3):
                    offset = t if other == axis else 1.0 if start & (4 >> other) else 0.0
                    total[:, other] += np.where(crossed, offset, 0.0)
                crossings += crossed
        mean = total / crossings[:, None]
        return np.stack([self.low[k] + self.step * (cell[k] + mean[:, k]) for k in range(3)], axis=1)

    def _quads(self, numbers: np.ndarray, field: np.ndarray) -> np.ndarray:
        """(quad_count, 4) vertices, counter-clockwise from outside: the four cells round each crossed edge."""
        strides = (self.cells[1] * self.cells[2], self.cells[2], 1)
        quads, owners = [], []
        for axis, stride in enumerate((4, 2, 1)):
            a, b = field[:, 0], field[:, stride]
            crossed = np.flatnonzero((a < 0.0) != (b < 0.0))
            u, v = strides[(axis + 1) % 3], strides[(axis + 2) % 3]
            here = numbers[crossed]
            round_edge = np.stack((here - u - v, here - v, here, here - u), axis=1)
            outwards = (a[crossed] < 0.0)[:, None]  # the field grows along the axis
            round_edge = np.where(outwards, round_edge, round_edge[:, ::-1])
            quad = np.searchsorted(numbers, round_edge)
            quads.append(quad)
            owners.append(crossed)
        order = np.argsort(np.concatenate(owners), kind="stable")
        return np.concatenate(quads)[order]


def _halve(positions: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Each quad as two triangles along its shorter diagonal."""

    def squared(i: int, j: int) -> np.ndarray:
        x, y, z = (positions[quads[:, i], k] - positions[quads[:, j], k] for k in range(3))
        return x * x + y * y + z * z

    turned = np.where((squared(1, 3) < squared(0, 2))[:, None], np.roll(quads, -1, axis=1), quads)
    return np.stack((turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]), axis=1).reshape(-1, 3)
