"""Mirrored edge collapses, guided by quadrics summed over several very different bodies, then mirrored edge flips."""

import heapq
from collections import defaultdict

import numpy as np

from geometry import mirrored_edge, quality, unit_normals


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
