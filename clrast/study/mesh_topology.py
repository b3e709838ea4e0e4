"""Which triangles share edges, by the positions of their vertices (files repeat vertices along seams)."""

from __future__ import annotations

import numpy as np


class Topology:
    """Edge i of a triangle joins its vertices i + 1 and i + 2 (modulo 3), as edge functions count them.

    places : (triangle_count, 3) int64, vertices numbered so that equal positions (-0 = 0) have equal numbers
    """

    def __init__(self, positions: np.ndarray, triangles: np.ndarray) -> None:
        rows = np.asarray(positions, dtype=np.float32) + np.float32(0)
        _, place_of_vertex = np.unique(rows, axis=0, return_inverse=True)
        self.places = place_of_vertex.reshape(-1).astype(np.int64)[np.asarray(triangles).astype(np.int64)]
        self.place_count = len(rows)
        a, b = np.roll(self.places, -1, axis=1), np.roll(self.places, -2, axis=1)
        self.keys = np.minimum(a, b) * self.place_count + np.maximum(a, b)
        flat = self.keys.reshape(-1)
        self.order = np.argsort(flat, kind="stable")
        self.sorted_keys = flat[self.order]

    def across(self, prim_id: int, edge: int) -> list[tuple[int, int]]:
        """(other triangle, its edge number) for every other triangle that has this edge."""
        a, b = self.places[prim_id, (edge + 1) % 3], self.places[prim_id, (edge + 2) % 3]
        if a == b:
            return []
        key = self.keys[prim_id, edge]
        low, high = np.searchsorted(self.sorted_keys, key), np.searchsorted(self.sorted_keys, key, side="right")
        found = [divmod(int(k), 3) for k in self.order[low:high]]
        return [(other, other_edge) for other, other_edge in found if other != prim_id]

    def shared_edge(self, prim_id: int, other: int) -> int | None:
        """The first edge of `prim_id` that `other` has too, or None."""
        for edge in range(3):
            if any(k == other for k, _ in self.across(prim_id, edge)):
                return edge
        return None

    def shared_places(self, prim_id: int, other: int) -> list[int]:
        """Vertices (0, 1, 2) of `prim_id` that lie where `other` has one."""
        return [k for k in range(3) if self.places[prim_id, k] in self.places[other]]

    def colours(self) -> np.ndarray:
        """(triangle_count,) int64: triangles that share an edge differ; the smallest free number in file order."""
        chosen = [-1] * len(self.places)
        is_edge = np.diff(self.sorted_keys, prepend=-1, append=-1) == 0
        shared = np.flatnonzero(is_edge[:-1] | is_edge[1:])
        owners: dict[int, list[int]] = {}
        for key, owner in zip(self.sorted_keys[shared].tolist(), (self.order[shared] // 3).tolist(), strict=True):
            owners.setdefault(key, []).append(owner)
        for k, keys in enumerate(self.keys.tolist()):
            near = {chosen[other] for key in keys for other in owners.get(key, ()) if other != k}
            colour = 0
            while colour in near:
                colour += 1
            chosen[k] = colour
        return np.array(chosen, dtype=np.int64)
