"""A scene as plain arrays and small records: what loaders fill in and the renderer reads.

All positions are world space. Transforms are applied in float64 and rounded to float32 once
(DESIGN section 1); from then on the float32 values are the scene.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

AlphaMode = Literal["OPAQUE", "MASK", "BLEND"]
WrapMode = Literal["repeat", "mirror", "clamp"]
Projection = Literal["perspective", "orthographic", "paraboloid", "latlong", "fisheye", "cube"]
LightKind = Literal["point", "spot", "directional"]


@dataclass(frozen=True)
class Texture:
    """One image. `texels` : (height, width, 4) uint8, row 0 is v = 0 (the top, as in glTF).

    RGB is sRGB-encoded where `srgb` is set, else linear; alpha is always linear.
    """

    name: str
    texels: np.ndarray
    srgb: bool = True


@dataclass(frozen=True)
class TextureUse:
    """How a material looks a texture up.

    `texture` indexes `Scene.textures`; `uv_set` is 0 or 1; `transform` is the 2x3 matrix, row by
    row (m00 m01 m02 m10 m11 m12), that takes (u, v, 1) to the coordinates looked up. `mipmap` : the file asks for
    mip maps.
    """

    texture: int
    uv_set: int = 0
    transform: tuple[float, float, float, float, float, float] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    wrap_u: WrapMode = "repeat"
    wrap_v: WrapMode = "repeat"
    nearest: bool = False
    mipmap: bool = False


@dataclass(frozen=True)
class Material:
    """glTF's metallic-roughness parameters. Colours are linear; `emissive` includes its strength."""

    name: str = "default"
    base_color: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    metallic: float = 0.0
    roughness: float = 1.0
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)
    alpha_mode: AlphaMode = "OPAQUE"
    alpha_cutoff: float = 0.5
    double_sided: bool = False
    unlit: bool = False
    transmission: float = 0.0
    ior: float = 1.5
    base_color_texture: TextureUse | None = None
    emissive_texture: TextureUse | None = None


@dataclass(frozen=True)
class Light:
    """A punctual light (KHR_lights_punctual): candela for point and spot, lux for directional.

    `intensity` : linear RGB, colour times strength. `direction` : unit vector, the way the light
    shines. `range` : metres, 0 for unbounded. Cones are half angles in radians.
    """

    name: str
    kind: LightKind
    intensity: tuple[float, float, float]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    range: float = 0.0
    inner_cone: float = 0.0
    outer_cone: float = 0.7853981633974483


@dataclass(frozen=True)
class Camera:
    """A view of the scene, before an image size is known.

    `fov` : full vertical angle in degrees. `height` : of an orthographic view, world units.
    """

    name: str = "camera"
    projection: Projection = "perspective"
    eye: tuple[float, float, float] = (0.0, 0.0, 1.0)
    look_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    fov: float = 45.0
    height: float = 2.0


@dataclass(frozen=True)
class Scene:
    """Triangles in the order of the file, with what shading needs.

    positions : (vertex_count, 3) float32, world space
    triangles : (triangle_count, 3) uint32, vertex indices; row k is prim_id k
    object_ids : (triangle_count,) uint32, into `object_names`
    material_ids : (triangle_count,) uint32, into `materials`
    normals : (vertex_count, 3) float32, world space, unit length, or zero where the file has
        none (the geometric normal is used there); None where no vertex has one
    uv, uv1 : (vertex_count, 2) float32, v grows downwards (glTF), or None
    colors : (vertex_count, 4) float32, linear, multiplied into the base colour, or None
    image_size : (width, height) that a card asks for, or None
    render_options : options of `render` that a card sets, by their names on the command line
    environment : linear RGB radiance that comes from everywhere where nothing is, or None
    warnings : sentences on what the file asks for and this program does not do
    """

    positions: np.ndarray
    triangles: np.ndarray
    object_ids: np.ndarray
    material_ids: np.ndarray
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None
    uv1: np.ndarray | None = None
    colors: np.ndarray | None = None
    materials: tuple[Material, ...] = (Material(),)
    textures: tuple[Texture, ...] = ()
    lights: tuple[Light, ...] = ()
    cameras: tuple[Camera, ...] = ()
    object_names: tuple[str, ...] = ("object",)
    image_size: tuple[int, int] | None = None
    render_options: dict[str, str] = field(default_factory=dict)
    environment: tuple[float, float, float] | None = None
    warnings: tuple[str, ...] = ()
    name: str = "scene"

    @property
    def triangle_count(self) -> int:
        return int(self.triangles.shape[0])

    @property
    def vertex_count(self) -> int:
        return int(self.positions.shape[0])

    def bounding_box(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the box round the vertices that triangles use: two (3,) float64, world space."""
        used = self.positions[self.triangles.reshape(-1)].astype(np.float64)
        return used.min(axis=0), used.max(axis=0)
