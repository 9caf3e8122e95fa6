"""From the source skin to one closed template of about 6,500 vertices.

Every template vertex is a fixed weighted average of source vertices (almost always a single one), so that every
shape target of the source applies to the template without any re-fitting.

1. Cut what cannot be seen from outside (mouth bag, nostrils, eye sockets) and cap the holes.
2. Split long edges with an interpolating stencil, so that legs and back are not coarser than the rest.
3. Collapse edges in mirrored pairs, guided by quadrics summed over several very different bodies.
4. Flip edges in mirrored pairs where that makes rounder triangles without bending the surface.
"""

import heapq
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
import scipy.sparse.csgraph as graph

import render
from source import Source

VIEW_COUNT = 200
HEAD_BOTTOM = 0.45  # source metres; nothing below the neck is hidden
SELDOM_SEEN = 8  # views out of 2 × VIEW_COUNT in which an inner quad may still appear


@dataclass
class Template:
    """Faces, the mirror map and the sparse matrix that makes template vertices from source vertices."""

    faces: np.ndarray
    mirror: np.ndarray
    from_source: sparse.csr_matrix

    @property
    def vertex_count(self) -> int:
        return self.from_source.shape[0]


# ---------------------------------------------------------------- 1. cutting and capping


def hidden_quads(source: Source) -> np.ndarray:
    """Quads of the head that hardly any of many outside views can see."""
    quads, positions = source.skin_quads, source.positions
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    head = np.flatnonzero(positions[triangles].mean(1)[:, 1] > HEAD_BOTTOM)
    seen = np.zeros(len(triangles), dtype=int)
    for index in range(VIEW_COUNT):
        height = 1 - 2 * (index + 0.5) / VIEW_COUNT
        turn = np.degrees(np.pi * (1 + 5**0.5) * (index + 0.5))
        turned = (positions - [0, 0.7, 0.03]) @ render.view_rotation(turn, np.degrees(np.arcsin(height))).T
        screen = np.stack([400 + 1200 * turned[:, 0], 400 - 1200 * turned[:, 1], turned[:, 2]], 1)
        winner, _ = render.rasterize(screen, triangles[head], 800, 800)
        seen[head[np.unique(winner[winner >= 0])]] += 1
    count = seen[: len(quads)] + seen[len(quads) :]
    is_head = np.isin(np.arange(len(quads)), head)
    return np.flatnonzero(is_head & (count <= SELDOM_SEEN))


def cut_region(source: Source, hidden: np.ndarray) -> np.ndarray:
    """The hidden quads of mouth, nostrils and eyes, made mirror symmetric and free of ragged borders."""
    quads = source.skin_quads
    lookup = {tuple(sorted(quad)): index for index, quad in enumerate(quads)}
    mirrored = np.array([lookup[tuple(sorted(source.mirror[quad]))] for quad in quads])
    centre = source.positions[quads].mean(1)
    side = np.abs(centre[:, 0])
    mouth = (centre[:, 1] < 0.668) & (side < 0.045)
    nostril = (centre[:, 1] >= 0.668) & (centre[:, 1] < 0.700) & (side < 0.03)
    eye = (centre[:, 1] >= 0.700) & (centre[:, 1] < 0.75) & (side > 0.01) & (side < 0.055)
    chosen = np.zeros(len(quads), bool)
    chosen[hidden] = True
    chosen &= (mouth | nostril | eye) & (centre[:, 2] > 0.03)
    chosen |= chosen[mirrored]
    neighbours = quad_neighbours(quads)
    for _ in range(6):
        around = np.array([chosen[near].sum() for near in neighbours])
        chosen = (chosen & (around >= 2)) | (around >= 3)
    chosen = keep_large_parts(chosen, neighbours, 20)
    return ~keep_large_parts(~chosen, neighbours, len(quads) // 2)  # what the cut isolates goes too


def quad_neighbours(quads):
    owners = defaultdict(list)
    for index, quad in enumerate(quads):
        for a, b in zip(quad, np.roll(quad, -1)):
            owners[min(a, b), max(a, b)].append(index)
    near = [[] for _ in quads]
    for pair in owners.values():
        for a in pair:
            near[a] += [b for b in pair if b != a]
    return [np.array(part) for part in near]


def keep_large_parts(chosen, neighbours, smallest):
    rows = np.repeat(np.arange(len(neighbours)), [len(n) for n in neighbours])
    columns = np.concatenate(neighbours)
    inside = chosen[rows] & chosen[columns]
    links = sparse.coo_matrix((np.ones(inside.sum()), (rows[inside], columns[inside])), shape=(len(chosen),) * 2)
    _, label = graph.connected_components(links, directed=False)
    size = np.bincount(label[chosen], minlength=label.max() + 1)
    return chosen & (size[label] >= smallest)


def boundary_loops(faces) -> list[list[int]]:
    """Loops of boundary edges, in the direction that a cap must use them (reverse of the faces')."""
    follow = {}
    edges = {(a, b) for face in faces for a, b in zip(face, np.roll(face, -1))}
    for a, b in edges:
        if (b, a) not in edges:
            if b in follow:
                raise ValueError(f"the cut region touches itself at source vertex {b}")
            follow[b] = a
    loops = []
    while follow:
        start, current = follow.popitem()
        loop = [start]
        while current != start:
            loop.append(current)
            current = follow.pop(current)
        loops.append(loop)
    return loops


def cheapest_triangulation(points: np.ndarray) -> list[tuple[int, int, int]]:
    """Triangulation of a polygon with the smallest summed edge length (dynamic programming)."""
    count = len(points)
    length = np.linalg.norm(points[:, None] - points[None], axis=2)
    cost = np.zeros((count, count))
    split = np.zeros((count, count), int)
    for gap in range(2, count):
        for i in range(count - gap):
            j = i + gap
            options = [cost[i, k] + cost[k, j] + length[i, k] + length[k, j] for k in range(i + 1, j)]
            best = int(np.argmin(options))
            cost[i, j], split[i, j] = options[best], i + 1 + best
    triangles, stack = [], [(0, count - 1)]
    while stack:
        i, j = stack.pop()
        if j - i < 2:
            continue
        k = split[i, j]
        triangles.append((i, k, j))
        stack += [(i, k), (k, j)]
    return triangles


def cap_mouth(loop, source: Source):
    """Zip a loop that crosses the mirror plane: triangulate its left half and mirror it."""
    on_plane = [index for index, vertex in enumerate(loop) if source.mirror[vertex] == vertex]
    if len(on_plane) != 2:
        raise ValueError(f"the mouth loop meets the mirror plane {len(on_plane)} times instead of twice")
    first, second = on_plane
    half = loop[first : second + 1]
    if source.positions[half[len(half) // 2], 0] < 0:
        half = loop[second:] + loop[: first + 1]
    triangles = [tuple(half[k] for k in t) for t in cheapest_triangulation(source.positions[half])]
    return triangles + [tuple(source.mirror[list(t)][::-1]) for t in triangles]


def triangulate(source: Source, cut: np.ndarray):
    """Triangles of the closed skin over source vertices."""
    positions, mirror = source.positions, source.mirror
    triangles = []
    for quad in source.skin_quads[~cut]:
        even = np.linalg.norm(positions[quad[0]] - positions[quad[2]])
        odd = np.linalg.norm(positions[quad[1]] - positions[quad[3]])
        canonical = min(quad) if min(quad) < min(mirror[quad]) else int(mirror[min(mirror[quad])])
        if abs(even - odd) > 1e-9:
            use_even = even < odd
        else:
            use_even = canonical in (quad[0], quad[2])
        a, b, c, d = quad if use_even else np.roll(quad, -1)
        triangles += [(a, b, c), (a, c, d)]
    for loop in boundary_loops(source.skin_quads[~cut]):
        if any(mirror[vertex] == vertex for vertex in loop):
            triangles += cap_mouth(loop, source)
            continue
        centre = positions[loop].mean(0)
        if centre[1] > 0.700:
            tip = source.eye_front["left" if centre[0] > 0 else "right"]
            triangles += [(a, b, tip) for a, b in zip(loop, loop[1:] + loop[:1])]
        elif centre[0] > 0:
            half = [tuple(loop[k] for k in t) for t in cheapest_triangulation(positions[loop])]
            triangles += half + [tuple(mirror[list(t)][::-1]) for t in half]
    return np.array(triangles)


# ---------------------------------------------------------------- 2. splitting long edges


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


def mirrored_edge(edge, mirror):
    a, b = int(mirror[edge[0]]), int(mirror[edge[1]])
    return (min(a, b), max(a, b))


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


# ---------------------------------------------------------------- 3. mirrored edge collapse


class Decimation:
    """Mirrored half-edge collapse: a vertex is only ever merged into a neighbour that stays where it is."""

    def __init__(self, faces, mirror, shapes, wanted_length, tolerance):
        self.faces = {index: tuple(int(v) for v in face) for index, face in enumerate(faces)}
        self.mirror = [int(v) for v in mirror]
        self.shapes = np.ascontiguousarray(np.moveaxis(shapes, 0, 1))  # vertex, shape, coordinate
        self.wanted_length = wanted_length
        self.tolerance = tolerance
        self.at = defaultdict(set)
        for index, face in self.faces.items():
            for vertex in face:
                self.at[vertex].add(index)
        self.quadrics = self._vertex_quadrics()
        self.version = defaultdict(int)

    def _vertex_quadrics(self):
        quadrics = np.zeros((self.shapes.shape[0], self.shapes.shape[1], 4, 4))
        weights = np.zeros((self.shapes.shape[0], self.shapes.shape[1]))
        for face in self.faces.values():
            corners = self.shapes[list(face)]
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            area = np.linalg.norm(normal, axis=1)
            normal = normal / np.maximum(area, 1e-15)[:, None]
            plane = np.concatenate([normal, -(normal * corners[0]).sum(1, keepdims=True)], axis=1)
            quadric = area[:, None, None] * plane[:, :, None] * plane[:, None, :]
            for vertex in face:
                quadrics[vertex] += quadric
                weights[vertex] += area
        return quadrics / np.maximum(weights, 1e-15)[:, :, None, None].mean(1, keepdims=True)

    def neighbours(self, vertex):
        return {other for index in self.at[vertex] for other in self.faces[index]} - {vertex}

    def cost(self, gone, kept):
        """Squared plane error over tolerance plus squared length over wanted length (both without unit)."""
        point = np.concatenate([self.shapes[kept], np.ones((self.shapes.shape[1], 1))], axis=1)
        error = np.einsum("si,sij,sj->s", point, self.quadrics[gone], point).clip(0).mean()
        length = np.linalg.norm(self.shapes[gone] - self.shapes[kept], axis=1).mean()
        wanted = 0.5 * (self.wanted_length[gone] + self.wanted_length[kept])
        tolerance = 0.5 * (self.tolerance[gone] + self.tolerance[kept])
        return (length / wanted) ** 2 + error / tolerance**2

    def legal(self, gone, kept):
        around_gone, around_kept = self.neighbours(gone), self.neighbours(kept)
        if kept not in around_gone or len(around_gone & around_kept) != 2:
            return False
        if any(len(self.at[v]) <= 3 for v in around_gone & around_kept):
            return False
        if len(around_gone) + len(around_kept) - 4 > 9:
            return False
        moved = [self.faces[index] for index in self.at[gone] if kept not in self.faces[index]]
        before = self.shapes[np.array(moved)]
        after = self.shapes[np.array([[kept if v == gone else v for v in face] for face in moved])]
        old = np.cross(before[:, 1] - before[:, 0], before[:, 2] - before[:, 0])
        new = np.cross(after[:, 1] - after[:, 0], after[:, 2] - after[:, 0])
        old_length, new_length = np.linalg.norm(old, axis=2), np.linalg.norm(new, axis=2)
        if ((old * new).sum(2) < 0.35 * old_length * new_length).any():
            return False
        edges = sum(((after[:, k] - after[:, (k + 1) % 3]) ** 2).sum(2) for k in range(3))
        longest_allowed = 2.2 * self.wanted_length[gone]
        reach = np.linalg.norm(self.shapes[list(around_gone - {kept})] - self.shapes[kept], axis=2)
        return bool((new_length > 0.12 * edges).all() and (reach.mean(1) < longest_allowed).all())

    def collapse(self, gone, kept):
        """Merge; returns what is needed to undo."""
        undo = {index: self.faces[index] for index in self.at[gone]}
        for index in list(self.at[gone]):
            face = self.faces[index]
            for vertex in face:
                self.at[vertex].discard(index)
            if kept in face:
                del self.faces[index]
                continue
            self.faces[index] = tuple(kept if v == gone else v for v in face)
            for vertex in self.faces[index]:
                self.at[vertex].add(index)
        self.quadrics[kept] += self.quadrics[gone]
        return gone, kept, undo

    def undo(self, record):
        gone, kept, faces = record
        for index, face in faces.items():
            for vertex in self.faces.pop(index, ()):
                self.at[vertex].discard(index)
            self.faces[index] = face
            for vertex in face:
                self.at[vertex].add(index)
        self.quadrics[kept] -= self.quadrics[gone]

    def collapse_pair(self, gone, kept):
        """Collapse an edge and its mirror image, or neither."""
        mirror = self.mirror
        if mirror[gone] == gone and mirror[kept] != kept:
            return False
        if mirror[gone] == kept or not self.legal(gone, kept):
            return False
        first = self.collapse(gone, kept)
        if mirror[gone] == gone:
            return True
        if not self.legal(mirror[gone], mirror[kept]):
            self.undo(first)
            return False
        self.collapse(mirror[gone], mirror[kept])
        return True

    def run(self, vertex_target):
        alive = sum(1 for v in self.at if self.at[v])
        heap = []
        for gone in list(self.at):
            self._push(heap, gone)
        heapq.heapify(heap)
        while alive > vertex_target and heap:
            _, gone, kept, stamp = heapq.heappop(heap)
            if not self.at[gone] or not self.at[kept] or stamp != self.version[gone] + self.version[kept]:
                continue
            if not self.collapse_pair(gone, kept):
                continue
            alive -= 1 if self.mirror[gone] == gone else 2
            for centre in {kept, self.mirror[kept]}:
                touched = self.neighbours(centre) | {centre}
                for vertex in touched:
                    self.version[vertex] += 1
                for vertex in touched:
                    self._push(heap, vertex)
                    for other in self.neighbours(vertex) - touched:
                        self._push_edge(heap, other, vertex)
        return np.array(sorted(self.faces.values()))

    def _push(self, heap, gone):
        for kept in self.neighbours(gone):
            self._push_edge(heap, gone, kept)

    def _push_edge(self, heap, gone, kept):
        if self.mirror[gone] >= gone:  # one side is enough, the other follows
            heapq.heappush(heap, (self.cost(gone, kept), gone, kept, self.version[gone] + self.version[kept]))


# ---------------------------------------------------------------- 4. mirrored edge flips


def flip_edges(faces, mirror, shapes, rounds=4):
    """Flip edges (with their mirror images) where the smallest angle grows and the surface stays put."""
    faces = [tuple(int(v) for v in face) for face in faces]
    for _ in range(rounds):
        owners = defaultdict(list)
        for index, face in enumerate(faces):
            for k in range(3):
                owners[tuple(sorted((face[k], face[(k + 1) % 3])))].append(index)
        valence = np.bincount(np.array(faces).ravel())
        used, changed = set(), 0
        for edge in sorted(owners):
            twin = mirrored_edge(edge, mirror)
            if twin < edge:
                continue
            touched = set(owners[edge]) | set(owners.get(twin, []))
            if twin not in owners or touched & used:
                continue
            first = flipped(edge, owners, faces, shapes, valence)
            second = flipped(twin, owners, faces, shapes, valence)
            if first is None or second is None:
                continue
            if edge != twin and set(owners[edge]) & set(owners[twin]):
                continue
            if edge == twin and {mirror[v] for v in first[2]} != set(first[2]):
                continue
            new_edge, new_twin = tuple(sorted(first[2])), tuple(sorted(second[2]))
            if new_edge in owners or new_twin in owners or (edge != twin and new_edge == new_twin):
                continue
            for owner, (one, two, _) in ((owners[edge], first), (owners[twin], second)):
                faces[owner[0]], faces[owner[1]] = one, two
            # Everything near by must wait for the next round, when the neighbourhood is known again.
            corners = {v for index in touched for v in faces[index]}
            used |= {index for index, face in enumerate(faces) if corners & set(face)} if len(corners) < 9 else touched
            changed += 1
        if not changed:
            break
    return np.array(sorted(faces))


def flipped(edge, owners, faces, shapes, valence):
    pair = owners[edge]
    first, second = faces[pair[0]], faces[pair[1]]
    a, b = edge
    if not any(first[k] == a and first[(k + 1) % 3] == b for k in range(3)):
        a, b = b, a
    c = next(v for v in first if v not in edge)
    d = next(v for v in second if v not in edge)
    if valence[a] <= 4 or valence[b] <= 4 or c == d:
        return None
    one, two = (a, d, c), (d, b, c)
    old = shapes[:, [first, second]]
    new = shapes[:, [one, two]]
    if quality(new).min(1).mean() < quality(old).min(1).mean() + 0.03:
        return None
    old_normals, new_normals = unit_normals(old), unit_normals(new)
    fold = (old_normals[:, 0] * old_normals[:, 1]).sum(1)
    alignment = np.einsum("sic,sjc->sij", old_normals, new_normals)
    if fold.min() < 0.85 or alignment.min() < 0.85:
        return None
    return one, two, (c, d)


def quality(corners):
    """4√3 · area / Σ edge², one for an equilateral triangle, of (…, 3, 3) corners."""
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    edges = sum(((corners[..., k, :] - corners[..., (k + 1) % 3, :]) ** 2).sum(-1) for k in range(3))
    return 2 * np.sqrt(3) * np.linalg.norm(normal, axis=-1) / np.maximum(edges, 1e-18)


def unit_normals(corners):
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-15)


# ---------------------------------------------------------------- checks


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
    template = Template(renumber[faces], renumber[mirror[kept]], from_source[kept].tocsr())
    check_closed_manifold(template.faces, template.vertex_count)
    check_mirror(template.faces, template.mirror)
    return template
