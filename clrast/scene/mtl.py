"""Wavefront MTL: the materials of an OBJ, as far as glTF's metallic-roughness model can say them.

Kd base colour (linear), map_Kd its texture, d or Tr opacity (below 1 the material is BLEND), Ke emission,
map_Ke its texture, Ni index of refraction. Ns with a Ks above 0 becomes roughness by alpha^2 = 2 / (Ns + 2),
alpha = roughness^2 (Blinn-Phong lobes as wide as a microfacet's). Everything is double-sided, as OBJ knows no
other. Texture options -s, -o, -clamp are applied. What else a material asks for is named in a warning, once.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

from clrast.errors import SceneError
from clrast.scene.model import Material, Texture, TextureUse, WrapMode
from clrast.scene.texture import load_image_file, read_below, resolve_below, shorten

MAX_LIBRARY_BYTES = 1 << 26
MAX_WARNINGS = 100
WHITE = (1.0, 1.0, 1.0)
_OPTION_WORDS = {
    "-blendu": 1, "-blendv": 1, "-cc": 1, "-clamp": 1, "-texres": 1, "-bm": 1, "-boost": 1, "-imfchan": 1,
    "-type": 1, "-mm": 2, "-colorspace": 1,
}  # fmt: skip
_VECTOR_OPTIONS = ("-s", "-o", "-t")
_HARMLESS = frozenset({"Ka", "illum", "sharpness", "map_Ka", "Km"})
_COUNTED = {"Ns": 1, "Ni": 1, "d": 1, "Tr": 1, "Pr": 1, "Pm": 1}
_MIRRORS, _GLASS = (3, 5, 8), (4, 6, 7, 9)


class MaterialLibrary:
    """The materials of the MTL files that an OBJ names; textures are decoded when a material is first used."""

    def __init__(self, folder: Path, statements: list[str], warnings: list[str]) -> None:
        self.folder = folder
        self.textures: list[Texture] = []
        self._warnings = warnings
        self._texture_numbers: dict[str, int | None] = {}
        self._entries: dict[str, dict[str, str]] = {}
        for statement in statements:
            for name in self._files_of(statement):
                self._read(name)

    def material(self, name: str | None, colored: bool) -> Material:
        """The material of a `usemtl` line; `colored` where vertex colours multiply it.

        None, or a name that no library has, is the default: light grey, white under vertex colours.
        """
        base = (*WHITE, 1.0) if colored else Material().base_color
        plain = Material(base_color=base, double_sided=True)
        if name is None:
            return plain
        entry = self._entries.get(name)
        if entry is None:
            self._warn(f"material '{shorten(name, 60)}' is in no MTL file that was read: taken as plain")
            return dataclasses.replace(plain, name=name)
        return self._translate(name, entry, base[:3])

    def _warn(self, text: str) -> None:
        if len(self._warnings) < MAX_WARNINGS and text not in self._warnings:
            self._warnings.append(text)

    def _files_of(self, statement: str) -> list[str]:
        """File names of an mtllib line: all of it where there is such a file, else its words."""
        try:
            if len(statement.split()) > 1 and not resolve_below(self.folder, statement, False).is_file():
                return statement.split()
        except (SceneError, OSError):
            return statement.split()
        return [statement] if statement else []

    def _read(self, name: str) -> None:
        try:
            text = read_below(self.folder, name, MAX_LIBRARY_BYTES, False).decode("utf-8", "replace")
        except SceneError as error:
            self._warn(f"material file left out: {error}")
            return
        entry: dict[str, str] = {}
        for line in text.replace("\r", "\n").split("\n"):
            words = line.split(None, 1)
            if not words or words[0].startswith("#"):
                continue
            rest = words[1].strip() if len(words) == 2 else ""
            if words[0] == "newmtl":
                entry = self._entries.setdefault(rest, {})
            else:
                entry[words[0]] = rest

    def _translate(self, name: str, entry: dict[str, str], base: tuple[float, ...]) -> Material:
        color_texture = self._texture(entry, "map_Kd", name)
        emissive_texture = self._texture(entry, "map_Ke", name)
        color = self._color(entry, "Kd", name, WHITE if color_texture else (base[0], base[1], base[2]))
        emissive = self._color(entry, "Ke", name, WHITE if emissive_texture else (0.0, 0.0, 0.0))
        opacity = self._number(entry, "d", name, 1.0 - self._number(entry, "Tr", name, 0.0))
        opacity = min(max(opacity, 0.0), 1.0)
        self._warn_of_the_rest(name, entry)
        ior = self._number(entry, "Ni", name, 1.5)
        return Material(
            name=name,
            base_color=(*color, opacity),
            roughness=self._roughness(name, entry),
            emissive=emissive,
            alpha_mode="BLEND" if opacity < 1.0 else "OPAQUE",
            double_sided=True,
            ior=ior if ior >= 1.0 else 1.5,
            base_color_texture=color_texture,
            emissive_texture=emissive_texture,
        )

    def _roughness(self, name: str, entry: dict[str, str]) -> float:
        if "Ns" not in entry or max(self._color(entry, "Ks", name, (0.0, 0.0, 0.0))) <= 0.0:
            return 1.0
        exponent = max(self._number(entry, "Ns", name, 0.0), 0.0)
        return math.sqrt(math.sqrt(2.0 / (exponent + 2.0)))

    def _warn_of_the_rest(self, name: str, entry: dict[str, str]) -> None:
        """One warning per kind of statement that is not used, whatever the number of materials."""
        for keyword, rest in entry.items():
            used = keyword in ("Kd", "Ke", "Ks", "Ns", "Ni", "d", "Tr", "map_Kd", "map_Ke") or keyword in _HARMLESS
            if keyword == "Tf" and set(rest.split()) <= {"1", "1.0", "1.00", "1.000", "1.0000", "1.000000"}:
                continue
            if not used:
                self._warn(f"MTL '{shorten(keyword, 20)}' is not used (such as in '{shorten(name, 40)}')")
        model = int(self._number(entry, "illum", name, 2.0))
        if model in _MIRRORS:
            self._warn(f"MTL illum {model} asks for mirror reflection, which is not made from it (such as in "
                       f"'{shorten(name, 40)}')")
        elif model in _GLASS:
            self._warn(f"MTL illum {model} asks for refraction, which is not made from it (such as in "
                       f"'{shorten(name, 40)}')")

    def _number(self, entry: dict[str, str], keyword: str, name: str, default: float) -> float:
        if keyword not in entry:
            return default
        numbers = self._numbers(entry[keyword], keyword, name)
        return numbers[-1] if numbers else default  # 'd -halo 0.5' ends with its number

    def _color(
        self, entry: dict[str, str], keyword: str, name: str, default: tuple[float, float, float]
    ) -> tuple[float, float, float]:
        """Three numbers, or one for all; 'spectral' and 'xyz' colours are not read."""
        if keyword not in entry:
            return default
        numbers = self._numbers(entry[keyword], keyword, name)
        if not numbers:
            self._warn(f"MTL '{keyword} {shorten(entry[keyword], 30)}' is not understood: default taken")
            return default
        red, green, blue = (numbers * 3)[:3] if len(numbers) < 3 else numbers[:3]
        return (max(red, 0.0), max(green, 0.0), max(blue, 0.0))

    def _numbers(self, text: str, keyword: str, name: str) -> list[float]:
        """The finite numbers at the start of a statement, `-halo` skipped; none where it is no list of numbers."""
        numbers: list[float] = []
        for word in text.partition("#")[0].split():
            if word == "-halo":
                continue
            try:
                number = float(word)
            except ValueError:
                break
            if not math.isfinite(number):
                self._warn(f"MTL '{keyword}' of '{shorten(name, 40)}' is not finite: default taken")
                return []
            numbers.append(min(max(number, -1e30), 1e30))
        return numbers

    def _texture(self, entry: dict[str, str], keyword: str, name: str) -> TextureUse | None:
        if not entry.get(keyword):
            return None
        file, options = self._texture_options(entry[keyword])
        number = self._texture_number(file)
        if number is None:
            return None
        for option in options.keys() - {"-s", "-o", "-clamp", "-blendu", "-blendv", "-cc", "-texres", "-type"}:
            self._warn(f"MTL texture option {option} is not used (such as in '{shorten(name, 40)}')")
        scale = [*self._numbers(options.get("-s", ""), "-s", name), 1.0, 1.0, 1.0]
        if len(scale) == 4:
            scale[1] = 1.0
        offset = [*self._numbers(options.get("-o", ""), "-o", name), 0.0, 0.0]
        wrap: WrapMode = "clamp" if options.get("-clamp", "off").lower() == "on" else "repeat"
        # OBJ: (u, v up) -> (su u + ou, sv v + ov); here v grows downwards on both sides: v' = 1 - (sv (1 - v) + ov)
        transform = (scale[0], 0.0, offset[0], 0.0, scale[1], 1.0 - scale[1] - offset[1])
        return TextureUse(number, transform=transform, wrap_u=wrap, wrap_v=wrap)

    def _texture_options(self, text: str) -> tuple[str, dict[str, str]]:
        """The file name of a map statement, which may have spaces, and the options before it."""
        words = text.split()
        options: dict[str, str] = {}
        while len(words) > 1 and (words[0] in _OPTION_WORDS or words[0] in _VECTOR_OPTIONS):
            option = words.pop(0)
            count = _OPTION_WORDS.get(option, 0)
            if option in _VECTOR_OPTIONS:
                while count < 3 and len(words) > count + 1 and self._is_number(words[count]):
                    count += 1
            options[option] = " ".join(words[:count])
            words = words[count:]
        return " ".join(words), options

    @staticmethod
    def _is_number(word: str) -> bool:
        try:
            float(word)
        except ValueError:
            return False
        return True

    def _texture_number(self, file: str) -> int | None:
        """The number of a texture file in `textures`, decoded once; None, and a warning, where it is missing."""
        if file not in self._texture_numbers:
            self._texture_numbers[file] = None
            try:
                texture = load_image_file(file, self.folder)
            except SceneError as error:
                self._warn(f"texture left out, its factor is used alone: {error}")
            else:
                self._texture_numbers[file] = len(self.textures)
                self.textures.append(texture)
        return self._texture_numbers[file]
