"""From the source skin to one closed template of about 6,500 vertices.

Every template vertex is a fixed weighted average of source vertices (four out of five times a single one), so that
every shape target of the source applies to the template without any re-fitting.

1. Cut what cannot be seen from outside (mouth bag, nostrils, eye sockets) and cap the holes.
2. Split long edges with an interpolating stencil, so that legs and back are not coarser than the rest.
3. Collapse edges in mirrored pairs, guided by quadrics summed over several very different bodies.
4. Flip edges in mirrored pairs where that makes rounder triangles without bending the surface.
5. Draw vertices towards their neighbours where the surface folds back on itself or toes and lips run into each other.
"""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse

from cutting import cut_region, hidden_quads, triangulate
from decimation import Decimation, flip_edges
from geometry import self_intersections, unit_normals
from source import Source
from splitting import split_long_edges

TOE_ROUNDS = 2  # of drawing the small toes apart from one another by shrinking them a little


@dataclass
class Template:
    """Faces, the mirror map and the sparse matrix that makes template vertices from source vertices."""

    faces: np.ndarray
    mirror: np.ndarray
    from_source: sparse.csr_matrix

    @property
    def vertex_count(self) -> int:
        return self.from_source.shape[0]


def relax(faces, mirror, from_source, sample_shapes, crowded, rounds=12, sharpest_fold=-0.6):
    """Average the rows of badly placed vertices with their neighbours' until folds and crossings are gone."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = len(mirror)
    links = sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    average = sparse.diags(1 / np.asarray(links.sum(1)).ravel()) @ links
    edges = np.sort(pairs, axis=1)
    order = np.lexsort((edges[:, 1], edges[:, 0])).reshape(-1, 2)
    sides = order % len(faces)
    for _ in range(TOE_ROUNDS):
        from_source = towards(average, from_source, 0.5 * (from_source @ crowded))
    for _ in range(rounds):
        bad = np.zeros(count, bool)
        for shape in sample_shapes:
            positions = from_source @ shape
            normals = unit_normals(positions[faces])
            folded = (normals[sides[:, 0]] * normals[sides[:, 1]]).sum(1) < sharpest_fold
            bad[faces[sides[folded]]] = True
            bad[faces[self_intersections(positions, faces)]] = True
        bad |= bad[mirror]
        if not bad.any():
            break
        share = 0.5 * bad + 0.25 * ((average @ bad > 0) & ~bad)
        from_source = towards(average, from_source, share)
    return from_source


def towards(average, from_source, share):
    """Rows of ``from_source`` moved by ``share`` towards the average of their neighbours."""
    return (sparse.diags(1 - share) @ from_source + sparse.diags(share) @ average @ from_source).tocsr()


def small_toes(source: Source) -> np.ndarray:
    """Share of every source vertex that belongs to the second to fifth toe."""
    share = np.zeros(len(source.positions))
    for name, entries in source.rig_weights().items():
        if name.startswith(("toe2", "toe3", "toe4", "toe5")):
            for vertex, weight in entries:
                share[vertex] += weight
    return np.clip(share, 0, 1)


def check_closed_manifold(faces, vertex_count):
    """Raise unless the surface is one closed, oriented, genus-0 two-manifold."""
    directed = set()
    for a, b, c in faces:
        for edge in ((a, b), (b, c), (c, a)):
            if edge in directed:
                raise ValueError(f"directed edge {edge} is used twice")
            directed.add(edge)
    if any((b, a) not in directed for a, b in directed):
        raise ValueError("the template has a boundary")
    if len(faces) * 3 != len(directed) or vertex_count - len(directed) // 2 + len(faces) != 2:
        raise ValueError("the template is not of genus 0")
    ring = defaultdict(dict)
    for a, b, c in faces:
        for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):
            ring[i][j] = k
    for vertex, follow in ring.items():
        start = current = next(iter(follow))
        steps = 0
        while True:
            current, steps = follow[current], steps + 1
            if current == start:
                break
        if steps != len(follow):
            raise ValueError(f"the faces around vertex {vertex} do not form one disc")


def check_mirror(faces, mirror):
    if not (mirror[mirror] == np.arange(len(mirror))).all():
        raise ValueError("the mirror map is not an involution")
    keys = {canonical(face) for face in faces}
    if any(canonical(mirror[list(face)][::-1]) not in keys for face in faces):
        raise ValueError("the mirror map does not map faces to faces")


def canonical(face):
    face = tuple(int(v) for v in face)
    turn = face.index(min(face))
    return face[turn:] + face[:turn]


def make_template(source: Source, sample_shapes, wanted, *, vertex_target, longest_edge) -> Template:
    """``sample_shapes``: (shapes, source vertices, 3); ``wanted(points)``: edge length and tolerance per vertex."""
    cut = cut_region(source, hidden_quads(source))
    triangles = triangulate(source, cut)
    used = np.unique(triangles)
    renumber = np.full(len(source.positions), -1)
    renumber[used] = np.arange(len(used))
    faces = renumber[triangles]
    source_mirror = source.mirror.copy()
    source_mirror[source.eye_front["left"]] = source.eye_front["right"]
    source_mirror[source.eye_front["right"]] = source.eye_front["left"]
    mirror = renumber[source_mirror[used]]
    count = len(source.positions)
    from_source = sparse.csr_matrix((np.ones(len(used)), (np.arange(len(used)), used)), shape=(len(used), count))
    check_closed_manifold(faces, len(used))
    check_mirror(faces, mirror)
    for _ in range(2):
        positions = from_source @ source.positions
        faces, mirror, from_source = split_long_edges(faces, mirror, from_source, positions, longest_edge)
    check_closed_manifold(faces, len(mirror))
    check_mirror(faces, mirror)

    shapes = np.stack([from_source @ shape for shape in sample_shapes])
    length, tolerance = wanted(from_source @ source.positions)
    faces = Decimation(faces, mirror, shapes, length, tolerance).run(vertex_target)
    faces = flip_edges(faces, mirror, shapes)

    kept = np.unique(faces)
    renumber = np.full(len(mirror), -1)
    renumber[kept] = np.arange(len(kept))
    faces, mirror, from_source = renumber[faces], renumber[mirror[kept]], from_source[kept].tocsr()
    from_source = relax(faces, mirror, from_source, sample_shapes[::2], small_toes(source))
    template = Template(faces, mirror, from_source)
    check_closed_manifold(template.faces, template.vertex_count)
    check_mirror(template.faces, template.mirror)
    return template
