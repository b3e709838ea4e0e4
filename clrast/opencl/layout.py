"""Every struct and constant that host and device share: their only home.

`kernels.py` turns both into C and prepends them to each program. Fields are ordered large to small,
so that no compiler adds padding; float4 fields use xyz and leave w at 0 unless a comment says more.
"""

from __future__ import annotations

import numpy as np

NO_HIT = 0xFFFFFFFF
"""`prim_id`, `object_id` and `material_id` where nothing is hit."""

MAX_IMAGE_SIDE = 65535
"""Pixels; screen bounds are kept in 16 bits a side."""

WIDE_TILE_COUNT = 12
"""A bound over more tiles than this makes a triangle wide."""

LARGE_BLOCK_COUNT = 24
"""A bound over more blocks of samples than this in one tile is tested block by block before samples are."""

CROSSING_RATIO = 2.0**-10
"""A vertex whose depth is under this share of its 1-norm distance counts as crossing the eye's plane."""

BOUND_SLACK = 16.0 * 2.0**-24
"""Relative widening of a projected screen bound; derived in cl/setup_triangles.cl."""

EDGE_SLACK = 8.0 * 2.0**-24
"""Forward error of an edge function, relative to the sum of its terms' magnitudes, where a bound is clipped."""

CHUNK_COUNT = 32
"""Runs of triangles that one work-item each counts and scatters; changes nothing but balance."""

PROJECTION_PERSPECTIVE = 0
PROJECTION_ORTHOGRAPHIC = 1

PRECISION_FAST = 0
PRECISION_ORDERED = 1
PRECISION_MIDPOINT = 2

EDGES_3D = 0
EDGES_2D = 1
EDGES_2DH = 2
EDGES_BARYCENTRIC = 3

EVALUATION_DIRECT = 0
EVALUATION_INCREMENTAL = 1

INCREMENT_CELL = 32
"""Samples a side of the squares in which incremental evaluation starts anew; a power of two."""

INCREMENT_SLACK = 64.0 * 2.0**-24
"""Error of an incrementally evaluated edge function relative to its terms: 16 sums, each within 2^-24, and slack."""

IS_OUTSIDE_NEVER = 0
IS_OUTSIDE_SCREEN_BOUND = 1

IS_OCCLUDED_NEVER = 0
IS_OCCLUDED_W_BUFFER = 1

SPLIT_FRUSTUM_NEVER = 0
SPLIT_FRUSTUM_CENTER = 1
SPLIT_FRUSTUM_SMALL = 2
SPLIT_FRUSTUM_ADAPTIVE = 3
SPLIT_FRUSTUM_ALWAYS = 4

GENERATE_SAMPLES_ROOT = 0
GENERATE_SAMPLES_LEAF = 1

BINNING_NEVER = 0
BINNING_BLOCKS = 1

MIN_FRUSTUM_LOG2 = 3
"""Frusta of 8 x 8 samples are not split (Davidovic et al., section 5)."""

NODE_WIDTH = 16
"""Children of a node of the BVH."""

LEAF_BIT = 0x80000000
"""Of a child: it is a leaf, the other bits are its first slot."""

EMPTY_CHILD = 0xFFFFFFFF

WORK_COUNTERS = (
    "setups", "edge_evaluations", "samples_tested", "samples_covered", "samples_written", "traversal_steps",
    "frusta_split", "blocks_culled", "nodes_culled",
)  # fmt: skip
"""Columns of a work item's counters, in the order of `Work` in cl/counters.clh."""

WORK_COUNTER_COUNT = len(WORK_COUNTERS)

LIGHT_POINT = 0
LIGHT_SPOT = 1
LIGHT_DIRECTIONAL = 2

WRAP_REPEAT = 0
WRAP_MIRROR = 1
WRAP_CLAMP = 2

MATERIAL_MASK = 1
MATERIAL_BLEND = 2
MATERIAL_UNLIT = 4

NO_TEXTURE = 0xFFFFFFFF

PLANE_NONE = 0xFFFFFFFF
"""Of an output channel group: not asked for."""

FLOAT4 = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("w", "<f4")])

VIEW = np.dtype(
    [
        ("origin", "<f4", 4),  # perspective: eye; orthographic: ray origin of the image's centre
        ("origin_low", "<f4", 4),  # orthographic: what float32 lost of that origin
        ("axis", "<f4", 4),  # perspective: d at the image's centre; orthographic: d
        ("axis_low", "<f4", 4),  # perspective: what float32 lost of that d
        ("tangent_x", "<f4", 4),  # change of d (perspective) or of the origin (orthographic) per pixel to the right
        ("tangent_y", "<f4", 4),  # the same per pixel downwards
        ("inverse_x", "<f4", 4),  # dot with (p - origin): X (times depth in perspective), for bounds only
        ("inverse_y", "<f4", 4),
        ("inverse_w", "<f4", 4),  # dot with (p - origin): depth along the view axis
        ("first", "<f4", 4),  # as defined: d0 (perspective) or e0 (orthographic), of sample (0, 0)
        ("center_x", "<f4"),  # width / 2, exact; X = x - center_x
        ("center_y", "<f4"),
        ("focal", "<f4"),  # pixels: scale of the screen's rounding errors (see cl/setup_triangles.cl)
        ("world_scale", "<f4"),  # power of two by which positions and origin are multiplied on the device
        ("width", "<u4"),  # pixels
        ("height", "<u4"),
        ("tile_columns", "<u4"),
        ("tile_rows", "<u4"),
        ("band_row", "<u4"),  # first tile row of this band
        ("band_rows", "<u4"),  # tile rows in this band
        ("unused0", "<u4"),
        ("unused1", "<u4"),
    ]
)
"""The camera and the image, as every kernel gets them."""

MATERIAL = np.dtype(
    [
        ("base_color", "<f4", 4),  # linear RGB and alpha
        ("emissive", "<f4", 4),  # linear RGB, times strength
        ("base_u", "<f4", 4),  # dot with (u, v, 1): u that the base-colour texture is looked up at
        ("base_v", "<f4", 4),
        ("emissive_u", "<f4", 4),
        ("emissive_v", "<f4", 4),
        ("metallic", "<f4"),
        ("roughness", "<f4"),
        ("alpha_cutoff", "<f4"),
        ("ior", "<f4"),
        ("base_texture", "<u4"),  # index into the textures, or NO_TEXTURE
        ("base_lookup", "<u4"),  # bits 0-1 wrap u, 2-3 wrap v, 4 nearest, 5 second uv set
        ("emissive_texture", "<u4"),
        ("emissive_lookup", "<u4"),
        ("flags", "<u4"),  # MATERIAL_MASK | MATERIAL_BLEND | MATERIAL_UNLIT
        ("unused0", "<u4"),
        ("unused1", "<u4"),
        ("unused2", "<u4"),
    ]
)

TEXTURE = np.dtype(
    [
        ("first_texel", "<u4"),  # into the texels of all textures, 4 bytes each
        ("width", "<u4"),
        ("height", "<u4"),
        ("srgb", "<u4"),  # 1: RGB bytes go through the sRGB table
    ]
)

LIGHT = np.dtype(
    [
        ("position", "<f4", 4),  # world space
        ("direction", "<f4", 4),  # unit, the way the light shines
        ("intensity", "<f4", 4),  # candela (point, spot) or lux (directional), linear RGB
        ("cos_inner", "<f4"),
        ("cos_outer", "<f4"),
        ("range", "<f4"),  # world units, 0 for unbounded
        ("kind", "<u4"),  # LIGHT_POINT, LIGHT_SPOT, LIGHT_DIRECTIONAL
    ]
)

PLANES = np.dtype(
    [
        ("color", "<u4"),  # first plane of R G B A in the float output, or PLANE_NONE
        ("depth", "<u4"),  # Z
        ("distance", "<u4"),
        ("normal", "<u4"),  # N.XYZ, then Ng.XYZ
        ("position", "<u4"),
        ("bary", "<u4"),
        ("uv", "<u4"),
        ("albedo", "<u4"),
        ("ray", "<u4"),  # ray.XYZ, raydx.XYZ, raydy.XYZ
        ("id", "<u4"),  # first plane of id.object and id.material in the uint output, or PLANE_NONE
    ]
)
"""Where `shade_hits` writes each channel group: plane k starts at k * pixel count."""

STRUCTS = {"View": VIEW, "Material": MATERIAL, "Texture": TEXTURE, "Light": LIGHT, "Planes": PLANES}

CONSTANTS: dict[str, int | float] = {
    name: value
    for name, value in list(globals().items())
    if name.isupper() and isinstance(value, (int, float)) and not isinstance(value, bool)
}
