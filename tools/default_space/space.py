"""Alignment, principal components and the files that are written."""

import io
import json
import zipfile

import numpy as np


def align(bodies, rounds=4):
    """Generalized Procrustes without scale: turn and shift every body (n, V, 3) onto the mean body."""
    aligned = bodies - bodies.mean(1, keepdims=True)
    for _ in range(rounds):
        aligned = turned_onto(aligned, aligned.mean(0))
    return aligned


def align_to(bodies, mean):
    """Turn and shift every body onto a given mean body."""
    centre = mean.mean(0)
    return turned_onto(bodies - bodies.mean(1, keepdims=True), mean - centre) + centre


def turned_onto(bodies, mean):
    u, _, vt = np.linalg.svd(np.einsum("nvi,vj->nij", bodies, mean))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return np.einsum("nvi,nij->nvj", bodies, u @ vt)


def principal_components(bodies, count):
    """Mean (V, 3), orthonormal rows (count, 3V) and standard deviations, through the Gram matrix."""
    flat = bodies.reshape(len(bodies), -1).astype(np.float64)
    mean = flat.mean(0)
    centred = flat - mean
    values, vectors = np.linalg.eigh(centred @ centred.T)
    order = np.argsort(-values)[:count]
    rows = (vectors[:, order].T @ centred) / np.sqrt(values[order])[:, None]
    # The sign of a component is free: the largest entry is made positive so that a re-run gives the same file.
    largest = np.take_along_axis(rows, np.abs(rows).argmax(1)[:, None], 1)
    rows *= np.sign(largest)
    return mean.reshape(-1, 3), rows, np.sqrt(values[order] / (len(bodies) - 1))


def write_npz(path, arrays: dict[str, np.ndarray]):
    """A deflated .npz whose bytes depend only on its content (fixed time stamps and order)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(array), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, buffer.getvalue(), compresslevel=9)


def json_bytes(value) -> np.ndarray:
    return np.frombuffer(json.dumps(value, sort_keys=True).encode(), dtype=np.uint8)
