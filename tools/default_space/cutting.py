"""Cuts what cannot be seen from outside (mouth bag, nostrils, eye sockets) and caps the holes."""

from collections import defaultdict

import numpy as np
import scipy.sparse as sparse
import scipy.sparse.csgraph as graph

import render
from source import Source

VIEW_COUNT = 200
HEAD_BOTTOM = 0.45  # source metres; nothing below the neck is hidden
SELDOM_SEEN = 8  # views out of 2 × VIEW_COUNT in which an inner quad may still appear


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
