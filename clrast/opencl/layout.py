"""Every struct that host and device share: their only home; and the constants of constants.py.

`kernels.py` turns both into C and prepends them to each program. Fields are ordered large to small,
so that no compiler adds padding; float4 fields use xyz and leave w at 0 unless a comment says more.
"""

from __future__ import annotations

import numpy as np

from clrast.opencl.constants import *  # noqa: F403

FLOAT4 = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("w", "<f4")])

VIEW = np.dtype(
    [
        ("origin", "<f4", 4),  # perspective: eye; orthographic: ray origin of the image's centre
        ("origin_low", "<f4", 4),  # orthographic: what float32 lost of that origin
        ("axis", "<f4", 4),  # perspective: d at the image's centre; orthographic: d; not planar: forward
        ("axis_low", "<f4", 4),  # perspective: what float32 lost of that d
        # change of d (perspective) or of the origin (orthographic) per pixel to the right; not planar: right
        ("tangent_x", "<f4", 4),
        ("tangent_y", "<f4", 4),  # the same per pixel downwards; not planar: up
        ("inverse_x", "<f4", 4),  # dot with (p - origin): X (times depth in perspective), for bounds only
        ("inverse_y", "<f4", 4),
        ("inverse_w", "<f4", 4),  # dot with (p - origin): depth along the view axis
        ("first", "<f4", 4),  # as defined: d0 (perspective) or e0 (orthographic), of sample (0, 0)
        ("direction_reach", "<f4", 4),  # largest size of d's components at any sample of the image, rounded up
        ("origin_reach", "<f4", 4),  # orthographic: the same of a ray's origin relative to `origin`
        ("center_x", "<f4"),  # width / 2, exact; X = x - center_x
        ("center_y", "<f4"),
        # pixels: scale of the screen's rounding errors (see cl/setup_triangles.cl); fisheye: the rim's angle, turns
        ("focal", "<f4"),
        ("world_scale", "<f4"),  # power of two by which positions and origin are multiplied on the device
        ("sample_x", "<f4"),  # where in its pixel a sample lies: a multiple of 1/256 in [0, 1), the centre by default
        ("sample_y", "<f4"),
        ("samples_left", "<f4"),  # where samples lie in any pass that shares the triangles' bounds, edges included
        ("samples_top", "<f4"),
        ("samples_right", "<f4"),
        ("samples_bottom", "<f4"),
        ("width", "<u4"),  # pixels
        ("height", "<u4"),
        ("tile_columns", "<u4"),
        ("tile_rows", "<u4"),
        ("band_top", "<u4"),  # first row of this band
        ("band_height", "<u4"),  # rows in this band: whole tiles, unless the image ends
    ]
)
"""The camera and the image, as every kernel gets them."""

CAMERA = np.dtype(
    [
        ("origin", "<f4", 4),  # e; orthographic: e0
        ("direction", "<f4", 4),  # d0; orthographic: d
        ("step_x", "<f4", 4),  # dx; orthographic: ex
        ("step_y", "<f4", 4),  # dy; orthographic: ey
    ]
)
"""The camera vectors as they are defined, at no scale: what exact arithmetic starts from."""

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
        ("flags", "<u4"),  # MATERIAL_MASK | MATERIAL_BLEND | MATERIAL_UNLIT | MATERIAL_SHINES (emits, or is unlit)
        ("transmission", "<f4"),
        ("reflectance", "<f4"),  # of a dielectric seen along its normal: ((ior - 1) / (ior + 1))^2
        ("unused", "<u4"),
    ]
)

TEXTURE = np.dtype(
    [
        ("first_texel", "<u4"),  # into the texels of all textures, 4 bytes each
        ("width", "<u4"),
        ("height", "<u4"),
        ("srgb", "<u4"),  # 1: RGB bytes go through the sRGB table
        ("level_count", "<u4"),  # mip maps that follow each other, the full image included
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

GRID = np.dtype(
    [
        ("low", "<f4", 4),  # lower corner, device space (world space times world_scale)
        ("cell", "<f4", 4),  # sides of a cell: at most 12 significant bits
        ("inverse_cell", "<f4", 4),
        ("pad", "<f4", 4),  # a triangle stands in each cell within this of it, by axis
        ("columns", "<u4"),  # cells along x, at most MAX_GRID_SIDE; a cell's number is (z * rows + y) * columns + x
        ("rows", "<u4"),
        ("layers", "<u4"),
        ("cell_count", "<u4"),
    ]
)
"""A uniform grid, without its lists."""

TREE_NODE = np.dtype(
    [
        ("low", "<f4", 3),
        ("left", "<u4"),
        ("high", "<f4", 3),  # negated
        ("right", "<u4"),
        ("parent", "<u4"),  # the root's: NOWHERE of cl/reinsert_subtrees.cl
        ("count", "<u4"),  # triangles
    ]
)
"""A triangle, or an inner node of a binary tree over triangles: its box, ids, and the triangles in it."""

STRUCTS = {
    "View": VIEW, "Camera": CAMERA, "Grid": GRID, "Material": MATERIAL, "Texture": TEXTURE, "Light": LIGHT,
    "Planes": PLANES, "TreeNode": TREE_NODE,
}  # fmt: skip

CONSTANTS: dict[str, int | float] = {
    name: value
    for name, value in list(globals().items())
    if name.isupper() and isinstance(value, (int, float)) and not isinstance(value, bool)
}
