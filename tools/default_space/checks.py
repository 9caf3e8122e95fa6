"""Checks on bodies of the finished space: folds, degenerate faces, reconstruction."""

import numpy as np

from geometry import quality, unit_normals


def edge_pairs(faces):
    """(edges, 2) indices of the two faces at every edge."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    return (order // 3).reshape(-1, 2)


def face_report(vertices, faces, pairs):
    """Smallest face quality, share of faces below 0.1, and number of edges where the surface folds back on itself."""
    corners = vertices[faces]
    grade = quality(corners)
    normals = unit_normals(corners)
    folds = (normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(1) < -0.9
    return grade.min(), (grade < 0.1).mean(), int(folds.sum())


def reconstruction_errors(bodies, mean, basis, deviations, counts=(10, 20, 50, 100)):
    """{components: (mean, 95th percentile, worst body's mean) vertex distance in mm}, coefficients inside ±3σ."""
    centred = (bodies - mean).reshape(len(bodies), -1)
    errors = {}
    for count in counts:
        rows = basis[:count].reshape(count, -1)
        coefficients = centred @ rows.T
        bound = 3 * deviations[:count]
        rest = centred - np.clip(coefficients, -bound, bound) @ rows
        distance = 1000 * np.linalg.norm(rest.reshape(bodies.shape), axis=2)
        errors[count] = (distance.mean(), np.percentile(distance, 95), distance.mean(1).max())
    return errors


def random_identities(count, components, random):
    return np.clip(random.standard_normal((count, components)), -3, 3)
