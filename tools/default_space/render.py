"""A small z-buffer renderer: enough to look at bodies and to ask which faces can be seen."""

import numpy as np


def rasterize(points, faces, width, height, chunk=4_000_000):
    """Face index (or -1) and depth of every pixel; points are (pixel x, pixel y, depth), larger depth is nearer."""
    corners = points[faces]
    low = np.floor(corners[:, :, :2].min(1)).astype(int)
    high = np.ceil(corners[:, :, :2].max(1)).astype(int) + 1
    low = np.maximum(low, 0)
    high = np.minimum(high, [width, height])
    extent = np.maximum(high - low, 0)
    counts = extent[:, 0] * extent[:, 1]
    depth = np.full(width * height, -np.inf)
    winner = np.full(width * height, -1, dtype=np.int64)
    order = np.flatnonzero(counts)
    start = 0
    cumulative = np.cumsum(counts[order])
    while start < len(order):
        base = cumulative[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(cumulative, base + chunk)))
        _splat(corners, low, extent, counts, order[start:stop], width, depth, winner)
        start = stop
    return winner.reshape(height, width), depth.reshape(height, width)


def _splat(corners, low, extent, counts, picked, width, depth, winner):
    face = np.repeat(picked, counts[picked])
    first = np.repeat(np.cumsum(counts[picked]) - counts[picked], counts[picked])
    local = np.arange(len(face)) - first
    columns = extent[face, 0]
    x = low[face, 0] + local % columns
    y = low[face, 1] + local // columns
    a, b, c = corners[face, 0], corners[face, 1], corners[face, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        u = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
        v = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
    inside = (u >= 0) & (v >= 0) & (u + v <= 1)
    face, x, y, u, v = face[inside], x[inside], y[inside], u[inside], v[inside]
    z = corners[face, 0, 2] * (1 - u - v) + corners[face, 1, 2] * u + corners[face, 2, 2] * v
    pixel = y * width + x
    order = np.lexsort((z, pixel))
    last = np.append(pixel[order][1:] != pixel[order][:-1], True) if len(order) else np.zeros(0, bool)
    best = order[last]
    nearer = z[best] > depth[pixel[best]]
    best = best[nearer]
    depth[pixel[best]] = z[best]
    winner[pixel[best]] = face[best]


def view_rotation(yaw_degrees, pitch_degrees=0.0):
    """Rotation that turns the world so that the camera looks along −z of the result."""
    yaw, pitch = np.radians([yaw_degrees, pitch_degrees])
    turn = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    return tilt @ turn


def vertex_normals(vertices, faces):
    face_normals = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], face_normals)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def picture(
    vertices, faces, *, yaw=0.0, pitch=0.0, centre, span, size, wire=False, colour=(0.80, 0.72, 0.66), labels=None
):
    """Shaded (height, width, 3) image; ``span`` is the height in metres that fills the picture."""
    width, height = size
    scale = height / span
    turned = (vertices - centre) @ view_rotation(yaw, pitch).T
    normals = vertex_normals(vertices, faces) @ view_rotation(yaw, pitch).T
    screen = np.stack([width / 2 + scale * turned[:, 0], height / 2 - scale * turned[:, 1], scale * turned[:, 2]], 1)
    winner, _ = rasterize(screen, faces, width, height)
    image = np.ones((height, width, 3))
    ys, xs = np.nonzero(winner >= 0)
    hit = winner[ys, xs]
    u, v = _barycentric(screen, faces, hit, xs, ys)
    weights = np.stack([1 - u - v, u, v], 1)[:, :, None]
    normal = (normals[faces[hit]] * weights).sum(1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    light = np.array([0.35, 0.5, 0.8]) / np.linalg.norm([0.35, 0.5, 0.8])
    shade = 0.25 + 0.65 * np.clip(normal @ light, 0, 1) + 0.1 * np.clip(normal[:, 2], 0, 1)
    tint = np.asarray(colour) if labels is None else (labels[faces[hit]] * weights).sum(1)
    pixels = shade[:, None] * tint
    inward = normal[:, 2] < -0.25
    pixels[inward] = [0.85, 0.1, 0.1]
    if wire:
        edge = np.minimum(np.minimum(u, v), 1 - u - v)
        pixels[edge < 0.06] *= 0.55
    image[ys, xs] = np.clip(pixels, 0, 1)
    return image


def _barycentric(screen, faces, hit, x, y):
    a, b, c = (screen[faces[hit, k], :2] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    u = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
    v = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
    return u, v


def sheet(rows):
    """One image from a list of rows of equally high images."""
    return np.concatenate([np.concatenate(row, axis=1) for row in rows], axis=0)


def save(path, image, colours=128):
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    picture = Image.fromarray((np.clip(image, 0, 1) * 255).astype(np.uint8))
    picture.quantize(colours).save(path, optimize=True)
