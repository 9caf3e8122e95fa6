"""Splits long edges with an interpolating stencil, so that legs and back are not coarser than the rest."""

from collections import defaultdict

import numpy as np
import scipy.sparse as sparse

from geometry import mirrored_edge


def split_long_edges(faces, mirror, from_source, positions, longest):
    """Insert interpolating-stencil points (butterfly) on edges longer than ``longest``; one pass."""
    owners = edge_opposites(faces)
    length = {edge: np.linalg.norm(positions[edge[0]] - positions[edge[1]]) for edge in owners}
    chosen = {edge for edge, value in length.items() if value > longest}
    chosen = {edge for edge in chosen} | {mirrored_edge(edge, mirror) for edge in chosen}
    next_vertex = len(positions)
    midpoint, rows = {}, []
    for edge in sorted(chosen):
        midpoint[edge] = next_vertex
        next_vertex += 1
        rows.append(butterfly_row(edge, owners, from_source))
    new_mirror = list(mirror) + [midpoint[mirrored_edge(edge, mirror)] for edge in sorted(chosen)]
    result = []
    for face in faces:
        result += split_face(tuple(face), midpoint, positions, mirror)
    stacked = sparse.vstack([from_source] + rows).tocsr() if rows else from_source
    return np.array(result), np.array(new_mirror), stacked


def edge_opposites(faces):
    owners = defaultdict(list)
    for a, b, c in faces:
        for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):
            owners[min(i, j), max(i, j)].append(k)
    return owners


def butterfly_row(edge, owners, from_source):
    a, b = edge
    row = 0.5 * (from_source[a] + from_source[b])
    for opposite in owners[edge]:
        row = row + 0.125 * from_source[opposite]
        for end in (a, b):
            wing = [v for v in owners[min(end, opposite), max(end, opposite)] if v not in edge]
            if len(wing) == 1:
                row = row - 0.0625 * from_source[wing[0]]
            else:
                row = row - 0.0625 * from_source[end]
    return row / row.sum()


def split_face(face, midpoint, positions, mirror):
    middle = [midpoint.get((min(a, b), max(a, b))) for a, b in zip(face, face[1:] + face[:1])]
    count = sum(m is not None for m in middle)
    if count == 0:
        return [face]
    if count == 3:
        a, b, c = face
        ab, bc, ca = middle
        return [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    if count == 1:
        turn = next(k for k in range(3) if middle[k] is not None)
        a, b, c = face[turn:] + face[:turn]
        return [(a, middle[turn], c), (middle[turn], b, c)]
    turn = next(k for k in range(3) if middle[k] is None)  # the edge a–b stays whole
    a, b, c = face[turn:] + face[:turn]
    bc, ca = middle[(turn + 1) % 3], middle[(turn + 2) % 3]
    half_bc, half_ca = (positions[b] + positions[c]) / 2, (positions[c] + positions[a]) / 2
    if np.linalg.norm(positions[a] - half_bc) <= np.linalg.norm(positions[b] - half_ca):
        return [(ca, bc, c), (a, b, bc), (a, bc, ca)]
    return [(ca, bc, c), (a, b, ca), (b, bc, ca)]
