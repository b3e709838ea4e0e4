"""Which way of antialiasing a render takes (`--aa`, `--filter`, `--shading-rate`), and the memory that it needs.

Colour is what samples are summed of. Every other channel is that of the sample at the pixel's centre, whatever `--aa`
says: ids, depth and normals are never blended.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from clrast.errors import CapacityError
from clrast.options import RenderOptions
from clrast.shading.filters import reach_of
from clrast.shading.multisample import Multisampler
from clrast.shading.rounds import rounds_of
from clrast.shading.shade import Shader
from clrast.shading.strata import StratifiedSampler
from clrast.shading.supersample import Layers, Supersampler
from clrast.visibility.sample_patterns import Antialiasing, Pattern, parse_antialiasing, with_rate

if TYPE_CHECKING:
    from clrast.opencl.device import Device
    from clrast.opencl.features import Features
    from clrast.visibility.sample_passes import SamplePasses


class Resolver(Protocol):
    """Replaces the colour of a band, shaded at the pixels' centres, by that of its samples."""

    counts: dict[str, int]
    shader: Shader

    @property
    def launches(self) -> int: ...

    def resolve_band(self, passes: SamplePasses, row: int, rows: int, pixel_count: int, target: Shader) -> None: ...


def antialiasing_of(options: RenderOptions) -> Antialiasing:
    """What the options ask for, of colour."""
    return with_rate(parse_antialiasing("--aa", options.aa_in_use), options.shading_rate)


def shares_shading(wanted: Antialiasing, blends: bool) -> bool:
    """Whether samples of one surface share its one shading. Where surfaces blend each sample has layers of its own."""
    return not blends and (wanted.kind == "csaa" or (wanted.kind == "msaa" and not wanted.shades_all))


def uses_centers(options: RenderOptions, blends: bool) -> bool:
    """Whether the colour of pixels' centres takes part in an image; where it does not, no ray need go on from them."""
    return blends or not antialiasing_of(options).shades_all


def resolver_bytes(options: RenderOptions, features: Features, blends: bool, of_rays: int) -> tuple[int, int]:
    """Device bytes a pixel of a band takes for antialiasing, and those of them in the largest buffer.

    of_rays : what rays from a shaded sample take.
    """
    wanted = antialiasing_of(options)
    if wanted.kind == "none":
        return 0, 0
    at_worst = options.memory is not None
    if wanted.threshold:
        layered = features if blends else None
        return StratifiedSampler.bytes_per_pixel(rounds_of(wanted), at_worst, layered, of_rays)
    if not shares_shading(wanted, blends):
        return Supersampler.bytes_per_pixel(), 20
    at_worst = at_worst or wanted.shades_all
    return Multisampler.bytes_per_pixel(wanted, options.filter, at_worst), max(20, 4 * wanted.depth_count)


def check_bands(options: RenderOptions, band_count: int) -> None:
    """Raises CapacityError where a filter takes samples of neighbours that are in another band."""
    if band_count > 1 and antialiasing_of(options).kind != "none" and reach_of(options.filter):
        raise CapacityError(
            f"--filter {options.filter} takes samples of neighbouring pixels, and the image does not fit into memory "
            "as a whole here: use --filter box, a smaller --size or more --memory"
        )


def make_resolver(
    device: Device, features: Features, options: RenderOptions, shader: Shader, max_pixels: int, layers: Layers | None
) -> Resolver | None:
    """The way that the options ask for, or None. shader : of the render; layers : where surfaces blend."""
    wanted = antialiasing_of(options)
    if wanted.kind == "none":
        return None
    blends = layers is not None
    if wanted.threshold:
        listed = shader.sibling(replace(features, sample_list=True), ("color",), 1)
        return StratifiedSampler(device, features, rounds_of(wanted), listed, max_pixels, blends)
    if shares_shading(wanted, blends):
        listed = shader.sibling(replace(features, sample_list=True), ("color",), 1)
        return Multisampler(device, features, wanted, options.filter, listed, max_pixels)
    color = shader.sibling(features, ("color",), max_pixels)
    # Nothing is shared: csaa shades those samples that have visibility of their own.
    pattern = Pattern(wanted.pattern.name, wanted.pattern.positions[: wanted.depth_count])
    return Supersampler(device, features, pattern, options.filter, color, max_pixels, layers)
