"""What a scene card may hold: the tables of data/README.md as pydantic models, and their mistakes in one line.

Angles are degrees here and radians in the Scene; colours are linear.
"""

from __future__ import annotations

import difflib
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from clrast.errors import SceneError
from clrast.scene.texture import shorten

MAX_SEGMENTS = 1024
MAX_SUBDIVISIONS = 8


def _list_of_one(value: Any) -> Any:
    return [value] if isinstance(value, dict) else value


def _three_alike(value: Any) -> Any:
    return [value] * 3 if isinstance(value, (int, float)) and not isinstance(value, bool) else value


def _two_alike(value: Any) -> Any:
    return [value] * 2 if isinstance(value, (int, float, str)) and not isinstance(value, bool) else value


def _file_alone(value: Any) -> Any:
    return {"file": value} if isinstance(value, str) else value


def _option_text(value: Any) -> Any:
    """An option's value as the command line writes it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, (int, float)):
        return str(value)
    if isinstance(value, list) and all(isinstance(member, str) for member in value):
        return ",".join(value)
    if isinstance(value, dict):
        states = {name: _option_text(state) for name, state in value.items()}
        if all(isinstance(state, str) for state in states.values()):
            return ",".join(f"{name}={state}" for name, state in states.items())
    return value


Number = Annotated[float, Field(ge=-1e30, le=1e30)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Intensity = Annotated[float, Field(ge=0.0, le=1e30)]
Index = Annotated[int, Field(ge=0, le=4294967293)]
Vector2 = Annotated[list[Number], Field(min_length=2, max_length=2)]
Vector3 = Annotated[list[Number], Field(min_length=3, max_length=3)]
Color = Annotated[list[Fraction], Field(min_length=3, max_length=4)]
Light3 = Annotated[list[Intensity], Field(min_length=3, max_length=3)]
Side = Annotated[int, Field(ge=1, le=65536)]
Wrap = Literal["repeat", "mirror", "clamp"]
OptionText = Annotated[str, BeforeValidator(_option_text)]
ShapeName = Literal["plane", "box", "sphere", "icosphere"]


class Table(BaseModel):
    """A table of a card: no key but those named, no value of another type."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class ImageTable(Table):
    size: Annotated[list[Side], Field(min_length=2, max_length=2)]


class RenderTable(Table):
    """Options of `render`, with underscores; their values are checked by the command line."""

    precision: OptionText | None = None
    method: OptionText | None = None
    mode: OptionText | None = None
    aov: OptionText | None = None
    effects: OptionText | None = None
    aa: OptionText | None = None
    shading_rate: OptionText | None = None
    filter: OptionText | None = None
    evaluation: OptionText | None = None
    intersection: OptionText | None = None
    accelerator: OptionText | None = None
    samples: OptionText | None = None
    seed: OptionText | None = None
    max_depth: OptionText | None = None


class Turn(Table):
    axis: Vector3
    degrees: Number

    @model_validator(mode="after")
    def _axis_points(self) -> Turn:
        if not any(self.axis):
            raise ValueError("axis is 0, 0, 0: give a direction, such as [0, 1, 0]")
        return self


class TextureTable(Table):
    """uv looked up: scaled, turned counter-clockwise as seen, then moved."""

    file: str
    uv_set: Literal[0, 1] = 0
    scale: Annotated[Vector2, BeforeValidator(_two_alike)] = [1.0, 1.0]
    rotate: Number = 0.0
    offset: Vector2 = [0.0, 0.0]
    wrap: Annotated[Annotated[list[Wrap], Field(min_length=2, max_length=2)], BeforeValidator(_two_alike)] = [
        "repeat",
        "repeat",
    ]
    nearest: bool = False
    mipmap: bool = False


TextureEntry = Annotated[TextureTable, BeforeValidator(_file_alone)]


class MaterialTable(Table):
    name: Annotated[str, Field(min_length=1)]
    base_color: Color | None = None
    metallic: Fraction = 0.0
    roughness: Fraction = 1.0
    emissive: Light3 | None = None
    alpha_mode: Literal["OPAQUE", "MASK", "BLEND"] = "OPAQUE"
    alpha_cutoff: Fraction = 0.5
    double_sided: bool = True
    unlit: bool = False
    transmission: Fraction = 0.0
    ior: Annotated[float, Field(ge=1.0, le=100.0)] = 1.5
    base_color_texture: TextureEntry | None = None
    emissive_texture: TextureEntry | None = None


class MeshTable(Table):
    name: Annotated[str, Field(min_length=1)] | None = None
    file: str | None = None
    shape: ShapeName | None = None
    segments: Annotated[int, Field(ge=3, le=MAX_SEGMENTS)] | None = None
    rings: Annotated[int, Field(ge=2, le=MAX_SEGMENTS)] | None = None
    subdivisions: Annotated[int, Field(ge=0, le=MAX_SUBDIVISIONS)] | None = None
    vertices: list[Vector3] | None = None
    triangles: list[Annotated[list[Index], Field(min_length=3, max_length=3)]] | None = None
    normals: list[Vector3] | None = None
    uv: list[Vector2] | None = None
    colors: list[Color] | None = None
    material: str | None = None
    smooth: bool | None = None
    scale: Annotated[Vector3, BeforeValidator(_three_alike)] | None = None
    rotate: Annotated[list[Turn], BeforeValidator(_list_of_one)] | None = None
    translate: Vector3 | None = None
    matrix: Annotated[list[Number], Field(min_length=16, max_length=16)] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> MeshTable:
        """One source of triangles, and only the keys that belong to it."""
        kinds = [kind for kind in ("file", "shape", "vertices") if getattr(self, kind) is not None]
        if len(kinds) != 1:
            found = "none of them" if not kinds else " and ".join(kinds)
            raise ValueError(f"needs one of file, shape or vertices, has {found}: keep one")
        kind = kinds[0]
        own = {
            "file": (),
            "vertices": ("triangles", "normals", "uv", "colors"),
            "shape": {"sphere": ("segments", "rings"), "icosphere": ("subdivisions",)}.get(self.shape or "", ()),
        }
        for key in ("triangles", "normals", "uv", "colors", "segments", "rings", "subdivisions"):
            if getattr(self, key) is not None and key not in own[kind]:
                what = f'shape "{self.shape}"' if kind == "shape" else kind
                raise ValueError(f"{key} does not go with {what}: leave it out")
        if kind == "vertices":
            self._check_inline()
        if self.matrix is not None:
            if self.scale or self.rotate or self.translate:
                raise ValueError("matrix stands for scale, rotate and translate together: keep one or the others")
            if self.matrix[12:] != [0.0, 0.0, 0.0, 1.0]:
                raise ValueError("matrix is row by row and ends with 0, 0, 0, 1: transpose it or mend its last row")
        return self

    def _check_inline(self) -> None:
        assert self.vertices is not None
        count = len(self.vertices)
        if not self.triangles:
            raise ValueError("vertices need triangles, such as [[0, 1, 2]]: add them")
        for number, triangle in enumerate(self.triangles):
            if max(triangle) >= count:
                raise ValueError(f"triangles[{number}] has index {max(triangle)}, there are {count} vertices: mend it")
        for key in ("normals", "uv", "colors"):
            rows = getattr(self, key)
            if rows is not None and len(rows) != count:
                raise ValueError(f"{key} has {len(rows)} rows, there are {count} vertices: give one for each")


class LightTable(Table):
    name: str | None = None
    kind: Literal["point", "spot", "directional"]
    color: Light3 = [1.0, 1.0, 1.0]
    intensity: Intensity = 1.0
    position: Vector3 | None = None
    direction: Vector3 | None = None
    look_at: Vector3 | None = None
    range: Intensity = 0.0
    inner_cone: Annotated[float, Field(ge=0.0, lt=90.0)] = 0.0
    outer_cone: Annotated[float, Field(gt=0.0, le=90.0)] = 45.0

    @model_validator(mode="after")
    def _placed(self) -> LightTable:
        if self.kind != "directional" and self.position is None:
            raise ValueError(f"a {self.kind} light needs a position, such as [0, 2, 0]: add it")
        if self.kind == "point" and (self.direction or self.look_at):
            raise ValueError("a point light shines everywhere: leave out direction and look_at")
        if self.kind != "point":
            if (self.direction is None) == (self.look_at is None):
                raise ValueError(f"a {self.kind} light needs direction or look_at, one of them: mend it")
            start = self.position or [0.0, 0.0, 0.0]
            if self.look_at is not None and self.position is None:
                raise ValueError("look_at is seen from position: add it, or give direction")
            toward = self.direction or [a - b for a, b in zip(self.look_at or start, start, strict=True)]
            if not any(toward):
                raise ValueError("the light shines nowhere: direction is 0, 0, 0 or look_at is position: mend it")
        if self.inner_cone >= self.outer_cone:
            raise ValueError("inner_cone must be smaller than outer_cone (half angles in degrees): mend one")
        return self


class CameraTable(Table):
    name: str | None = None
    projection: Literal["perspective", "orthographic", "paraboloid", "latlong", "fisheye", "cube"] = "perspective"
    eye: Vector3
    look_at: Vector3 = [0.0, 0.0, 0.0]
    up: Vector3 = [0.0, 1.0, 0.0]
    fov: Annotated[float, Field(gt=0.0, le=360.0)] | None = None
    height: Annotated[float, Field(gt=0.0, le=1e30)] = 2.0

    @model_validator(mode="after")
    def _check_fov(self) -> CameraTable:
        if self.fov is not None and self.fov >= 180.0 and self.projection != "fisheye":
            raise ValueError(f"fov is {self.fov:g}, it should be less than 180 (of a fisheye up to 360): mend it")
        return self


class EnvironmentTable(Table):
    """Light from everywhere where nothing is."""

    color: Light3 = [1.0, 1.0, 1.0]
    intensity: Intensity = 1.0


class CardTable(Table):
    name: str | None = None
    image: ImageTable | None = None
    render: RenderTable | None = None
    mesh: Annotated[list[MeshTable], Field(min_length=1)]
    material: list[MaterialTable] = []
    light: list[LightTable] = []
    camera: list[CameraTable] = []
    environment: EnvironmentTable | None = None


def check_card(tree: dict[str, Any]) -> CardTable:
    """The card of a TOML tree; SceneError that names the key, what is allowed there and the mend."""
    try:
        return CardTable.model_validate(tree)
    except ValidationError as error:
        faults = error.errors(include_url=False)
    more = f" ({len(faults) - 1} more like it or other)" if len(faults) > 1 else ""
    raise SceneError(_describe(faults[0]) + more)


def key_path(location: tuple[int | str, ...]) -> str:
    """`mesh[0].rotate[1].axis` of ("mesh", 0, "rotate", 1, "axis")."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text or "the card"


def _describe(fault: Any) -> str:
    location = fault["loc"]
    key = shorten(key_path(location), 100)
    kind = fault["type"]
    if kind == "extra_forbidden":
        known = _keys_at(location[:-1])
        near = difflib.get_close_matches(str(location[-1]), known, n=1)
        hint = f'did you mean "{near[0]}"?' if near else "leave it out"
        return f"{key} is no key of a card: {hint} (allowed: {', '.join(known)})"
    if kind == "missing":
        return f"{key} is missing: add it (see data/README.md)"
    if kind == "value_error":
        return f"{key}: {fault['ctx']['error']}"
    shown = shorten(repr(fault["input"]), 40)
    message = fault["msg"].replace("Input should", "should", 1)
    return f"{key} is {shown}, it {message}: mend it"


def _keys_at(location: tuple[int | str, ...]) -> list[str]:
    """The keys allowed in the table at a place of a card."""
    table: type[Table] = CardTable
    for part in location:
        if isinstance(part, str) and part in table.model_fields:
            inner = _table_in(table.model_fields[part].annotation)
            table = inner or table
    return list(table.model_fields)


def _table_in(annotation: Any) -> type[Table] | None:
    """The Table that a field's annotation holds, however deep."""
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return annotation
    for inner in get_args(annotation):
        found = _table_in(inner)
        if found is not None:
            return found
    return None
