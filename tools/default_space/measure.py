"""Tape and scale: stature, volume and girths of a closed body in the rest pose."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

BODY_DENSITY = 1000.0  # kg/m³, a little below that of lean tissue: the trunk encloses air


def volumes(vertices, faces):
    """(n,) enclosed volumes of (n, V, 3) bodies in cubic metres."""
    a, b, c = (vertices[:, faces[:, k]] for k in range(3))
    return np.einsum("nfi,nfi->n", a, np.cross(b, c)) / 6.0


def statures(vertices):
    return vertices[:, :, 1].max(1) - vertices[:, :, 1].min(1)


def hull_girth(vertices, faces, height):
    """Length of the convex outline (a taut tape) of a level cut through some faces; NaN when nothing is cut."""
    signed = vertices[:, 1] - height
    side = signed[faces] > 0
    crossing = faces[side.any(1) & ~side.all(1)]
    pairs = np.concatenate([crossing[:, [0, 1]], crossing[:, [1, 2]], crossing[:, [2, 0]]])
    a, b = signed[pairs[:, 0]], signed[pairs[:, 1]]
    cut = (a > 0) != (b > 0)
    pairs, a, b = pairs[cut], a[cut], b[cut]
    if len(pairs) < 3:
        return np.nan
    t = (a / (a - b))[:, None]
    points = vertices[pairs[:, 0]] * (1 - t) + vertices[pairs[:, 1]] * t
    try:
        return ConvexHull(points[:, [0, 2]]).area  # the perimeter: Qhull calls it the area of a flat hull
    except QhullError:
        return np.nan


class Tape:
    """Measures bodies that share the template's faces and named vertices."""

    def __init__(self, faces, main_bone, points, bones):
        self.points = points
        corner_bones = main_bone[faces]
        trunk = np.isin(corner_bones, [bones.index(b) for b in ("pelvis", "thorax", "left_thigh", "right_thigh")])
        self.trunk = faces[trunk.all(1)]
        left_leg = np.isin(corner_bones, [bones.index(b) for b in ("pelvis", "left_thigh", "left_shank")])
        self.left_leg = faces[left_leg.all(1)]

    def waist(self, vertices):
        return hull_girth(vertices, self.trunk, vertices[self.points["navel"], 1])

    def girths(self, vertices):
        """Chest, waist, hip and thigh girth of one body in metres."""
        at = {name: vertices[index] for name, index in self.points.items()}
        crotch, navel = at["crotch"][1], at["navel"][1]
        left_side = self.left_leg[(vertices[self.left_leg][:, :, 0] > 0).all(1)]
        hips = [hull_girth(vertices, self.trunk, h) for h in np.linspace(crotch + 0.02, navel - 0.06, 6)]
        return {
            "chest": hull_girth(vertices, self.trunk, at["left_nipple"][1]),
            "waist": self.waist(vertices),
            "hip": np.nanmax(hips),
            "thigh": hull_girth(vertices, left_side, crotch - 0.02),
        }
