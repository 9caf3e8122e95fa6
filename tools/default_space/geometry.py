"""Measures of triangles, and faces of one mesh that pass through each other."""

import numpy as np
from scipy.spatial import cKDTree


def quality(corners):
    """4√3 · area / Σ edge², one for an equilateral triangle, of (…, 3, 3) corners."""
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    edges = sum(((corners[..., k, :] - corners[..., (k + 1) % 3, :]) ** 2).sum(-1) for k in range(3))
    return 2 * np.sqrt(3) * np.linalg.norm(normal, axis=-1) / np.maximum(edges, 1e-18)


def unit_normals(corners):
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-15)


def mirrored_edge(edge, mirror):
    a, b = int(mirror[edge[0]]), int(mirror[edge[1]])
    return (min(a, b), max(a, b))


def self_intersections(vertices, faces):
    """Pairs of faces without a common vertex that pass through each other."""
    corners = vertices[faces]
    centre = corners.mean(1)
    reach = np.linalg.norm(corners - centre[:, None], axis=2).max(1)
    pairs = []
    for size in (0.01, 0.02, 0.08):  # small faces need not look far
        small = np.flatnonzero(reach <= size) if size < 0.08 else np.arange(len(faces))
        found = cKDTree(centre[small]).query_pairs(2 * min(size, reach[small].max()), output_type="ndarray")
        pairs.append(small[found])
    pairs = np.unique(np.concatenate(pairs), axis=0)
    near = np.linalg.norm(centre[pairs[:, 0]] - centre[pairs[:, 1]], axis=1) < reach[pairs].sum(1)
    pairs = pairs[near]
    low, high = corners.min(1), corners.max(1)
    overlap = (low[pairs[:, 0]] <= high[pairs[:, 1]]).all(1) & (low[pairs[:, 1]] <= high[pairs[:, 0]]).all(1)
    pairs = pairs[overlap]
    shared = (faces[pairs[:, 0]][:, :, None] == faces[pairs[:, 1]][:, None, :]).any((1, 2))
    pairs = pairs[~shared]
    hit = edges_pierce(corners[pairs[:, 0]], corners[pairs[:, 1]]) | edges_pierce(
        corners[pairs[:, 1]], corners[pairs[:, 0]]
    )
    return pairs[hit]


def edges_pierce(first, second):
    """Whether any edge of the first triangles passes through the second triangles."""
    a, b, c = second[:, 0], second[:, 1], second[:, 2]
    normal = np.cross(b - a, c - a)
    hit = np.zeros(len(first), bool)
    for k in range(3):
        start, way = first[:, k], first[:, (k + 1) % 3] - first[:, k]
        slope = (normal * way).sum(1)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (normal * (a - start)).sum(1) / slope
            point = start + t[:, None] * way
            inside = np.ones(len(first), bool)
            for p, q in ((a, b), (b, c), (c, a)):
                inside &= (np.cross(q - p, point - p) * normal).sum(1) > 0
            hit |= inside & (t > 0) & (t < 1)
    return hit
