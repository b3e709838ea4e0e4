"""The Cornell box in Mitsuba 3, in a process of its own.

    python cornell_worker.py CAMERA.npz OUT.npz BOUNCES BATCHES SAMPLES

What is compared is the transport of light: its integrator, sampler, emitter and visibility are Mitsuba's. The BRDF is
glTF's, written here again for it, as none of its own is the same: its plastics divide by what leaves the coat, its
metals mask in the separable form. Directions are drawn by the cosine alone. CAMERA.npz : e, d0, dx, dy, size.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from cornell_box import SURFACES
from cornell_mitsuba import box_tree, path_tree

mi.set_variant("llvm_ad_rgb")


class MetallicRoughness(mi.BSDF):
    """glTF 2.0, appendix B, on both sides of a surface."""

    def __init__(self, props: Any) -> None:
        mi.BSDF.__init__(self, props)
        surface = SURFACES[props["surface"]]
        self.base, self.metallic, self.alpha = mi.Color3f(*surface.base), surface.metallic, surface.roughness**2
        flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components, self.m_flags = [flags], flags

    def weigh(self, wi: Any, wo: Any) -> Any:
        """f times the cosine; both directions in the frame of the normal."""
        i, o = dr.abs(wi.z), dr.abs(wo.z)
        h = dr.normalize(wi + wo)
        n_h, v_h, a2 = dr.abs(h.z), dr.abs(dr.dot(wi, h)), self.alpha * self.alpha
        d = a2 * dr.rcp(dr.pi * dr.square(n_h * n_h * (a2 - 1) + 1))
        lambdas = [(dr.sqrt(1 + a2 * (1 - c * c) / (c * c)) - 1) / 2 for c in (i, o)]
        g = 1 / (1 + lambdas[0] + lambdas[1])
        f0 = self.base * self.metallic + 0.04 * (1 - self.metallic)
        fresnel = f0 + (1 - f0) * (1 - v_h) ** 5
        diffuse = (1 - fresnel) * self.base * ((1 - self.metallic) / dr.pi)
        return (diffuse + fresnel * (d * g / (4 * i * o))) * o

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        bs = mi.BSDFSample3f()
        wo = mi.warp.square_to_cosine_hemisphere(sample2)
        bs.wo = mi.Vector3f(wo.x, wo.y, dr.mulsign(wo.z, si.wi.z))
        bs.pdf = self.pdf(ctx, si, bs.wo, active)
        bs.eta, bs.sampled_type, bs.sampled_component = 1.0, +mi.BSDFFlags.DiffuseReflection, 0
        good = active & (bs.pdf > 0)
        return bs, dr.select(good, self.weigh(si.wi, bs.wo) / bs.pdf, 0)

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return dr.select(active & (si.wi.z * wo.z > 0), self.weigh(si.wi, wo), 0)

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return dr.select(active & (si.wi.z * wo.z > 0), dr.abs(wo.z) / dr.pi, 0)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def to_string(self) -> str:
        return "MetallicRoughness[]"


def build_scene(folder: Path, bounces: int) -> Any:
    mi.register_bsdf("metallic_roughness", MetallicRoughness)
    tree = box_tree(folder, lambda surface: {"type": "metallic_roughness", "surface": surface})
    return mi.load_dict({**tree, "integrator": path_tree(bounces)})


def main() -> None:
    camera, out = np.load(sys.argv[1]), Path(sys.argv[2])
    bounces, batches, samples = (int(text) for text in sys.argv[3:])
    scene = build_scene(out.parent, bounces)
    side = int(camera["size"])
    pixel = dr.arange(mi.UInt32, side * side * samples) // samples
    x, y = mi.Float(pixel % side) + 0.5, mi.Float(pixel // side) + 0.5
    e, d0, dx, dy = (mi.Vector3f(*(float(c) for c in camera[name])) for name in ("e", "d0", "dx", "dy"))
    sampler = mi.load_dict({"type": "independent"})
    means = []
    for batch in range(batches):
        sampler.seed(batch, side * side * samples)
        ray = mi.Ray3f(mi.Point3f(e), dr.normalize(d0 + x * dx + y * dy))
        color, *_ = scene.integrator().sample(scene, sampler, mi.RayDifferential3f(ray))
        found = np.array(color).reshape(3, side * side, samples)
        means.append(found.mean(axis=2).T.reshape(side, side, 3))
    np.savez(out, means=np.array(means))


if __name__ == "__main__":
    main()
