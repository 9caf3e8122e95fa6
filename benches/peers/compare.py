#!/usr/bin/env python3
"""Closest points and body evaluation beside what people use today: Open3D and numpy, on the meshes of our own benchmark.

    python3 benches/peers/compare.py [--export FOLDER] [--environment FOLDER]

Runs `cargo bench -p habitus --bench kernels`, installs the peers from PyPI into an environment of its own, checks that
they get the same answers, and prints how many times longer they take. Nothing here is part of the product.
"""
import argparse
import os
import subprocess
import sys
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PEERS = ["numpy==2.2.6", "open3d-cpu==0.19.0"]
# Ours is timed on one core, so are they; on a busy machine threads that wait for a core make them far slower still.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
REPEATS = 30
# Queries that are timed together, as in our benchmark: on a shared machine a short piece runs undisturbed now and then.
PIECE = 650


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--export", type=Path, help="an export that exists; without it the benchmark is run")
    parser.add_argument("--environment", type=Path, default=ROOT / "target" / "peers", help="where the peers are installed")
    arguments = parser.parse_args()
    python = environment(arguments.environment)
    export = arguments.export or run_benchmark(arguments.environment / "export")
    if not (export / "kernels.csv").exists():
        stop(f"{export}: no kernels.csv there; leave --export out and the benchmark writes one")
    measured = subprocess.run([python, __file__, "--measure", export], env={**os.environ, **ONE_THREAD})
    sys.exit(measured.returncode)


def stop(message):
    print(f"compare: {message}", file=sys.stderr)
    sys.exit(1)


def environment(folder):
    """Python of an environment that has the peers; made on first use."""
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    probe = [python, "-c", "import numpy, open3d"]
    if python.exists() and subprocess.run(probe, capture_output=True).returncode == 0:
        return python
    print(f"installing {', '.join(PEERS)} into {folder}", flush=True)
    venv.create(folder, with_pip=True)
    install = [python, "-m", "pip", "install", "--quiet", "--retries", "1", *PEERS]
    if subprocess.run(install).returncode != 0:
        stop("the peers cannot be installed: is there a network, and a wheel for this Python (3.8 to 3.12)?")
    found = subprocess.run(probe, capture_output=True, text=True)
    if found.returncode != 0:
        last = found.stderr.strip().splitlines()[-1:]
        stop(f"the peers were installed but cannot be loaded: {' '.join(last)} (Open3D needs libgomp1, libgl1, libx11-6)")
    return python


def run_benchmark(export):
    command = ["cargo", "bench", "-p", "habitus", "--bench", "kernels", "--", "--export", str(export)]
    if subprocess.run(command, cwd=ROOT).returncode != 0:
        stop("the benchmark failed; see above")
    return export


def measure(export):
    """Runs inside the environment."""
    ours = read_table(export / "kernels.csv")
    rows = closest_points(export, ours) + body(export, ours)
    print(f"\n{'one core':<48}{'peer ms':>10}{'ours ms':>10}{'ratio':>8}   same answer within")
    for name, peer_ms, our_ms, difference in rows:
        print(f"{name:<48}{peer_ms:>10.3f}{our_ms:>10.3f}{peer_ms / our_ms:>8.1f}   {1e6 * difference:.2f} µm")
    if any(difference > 1e-5 for *_, difference in rows):
        stop("answers differ by more than 10 µm: the comparison means nothing")


def best_ms(task):
    task()
    times = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        task()
        times.append(time.perf_counter() - begun)
    return 1e3 * min(times)


def read_table(path):
    lines = path.read_text().splitlines()[1:]
    return {line.split(",")[0]: float(line.split(",")[1]) for line in lines}


def read_ply(path):
    """Positions and faces of a binary PLY as the benchmark writes it."""
    import numpy as np

    header, body = path.read_bytes().split(b"end_header\n", 1)
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4"}
    element, counts, properties = None, {}, {}
    for words in (line.split() for line in header.decode().splitlines()):
        if words[0] == "element":
            element = words[1]
            counts[element], properties[element] = int(words[2]), []
        elif words[0] == "property" and words[1] == "list":
            properties[element] += [("corners", kinds[words[2]]), ("vertices", kinds[words[3]], 3)]
        elif words[0] == "property":
            properties[element].append((words[2], kinds[words[1]]))
    vertices = np.frombuffer(body, np.dtype(properties["vertex"]), counts["vertex"])
    positions = np.stack([vertices["x"], vertices["y"], vertices["z"]], axis=1).astype(np.float64)
    if not counts.get("face"):
        return positions, None
    faces = np.frombuffer(body, np.dtype(properties["face"]), counts["face"], offset=vertices.nbytes)
    return positions, faces["vertices"].astype(np.uint32)


def closest_points(export, ours):
    import numpy as np
    import open3d

    positions, faces = read_ply(export / "capture.ply")
    queries, _ = read_ply(export / "queries.ply")
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(open3d.core.Tensor(positions.astype(np.float32)), open3d.core.Tensor(faces))
    tensor = open3d.core.Tensor(queries.astype(np.float32))
    pieces = [tensor[start:start + PIECE].contiguous() for start in range(0, len(queries), PIECE)]
    peer = sum(best_ms(lambda: scene.compute_closest_points(piece, nthreads=1)) for piece in pieces)
    points = scene.compute_closest_points(tensor, nthreads=1)["points"].numpy()
    distances = np.linalg.norm(points - queries, axis=1)
    expected = np.loadtxt(export / "distances.csv")
    difference = np.abs(distances - expected).max()
    name = f"Open3D, {len(queries)} points on {len(faces)} triangles"
    return [(name + ", cold", peer, ours["closest point; cold"], difference),
            (name + ", warm", peer, ours["closest point; warm"], difference)]


def body(export, ours):
    """The embedded model in plain numpy: one product for the identity, one for the blended transforms."""
    import numpy as np

    model = np.load(ROOT / "crates" / "habitus" / "assets" / "default_space.npz")
    mean = model["mean"].astype(np.float32)
    count = len(mean)
    deviations = model["standard_deviations"].astype(np.float32)
    basis = (model["basis"].astype(np.float32).reshape(len(deviations), -1) * deviations[:, None]).T.copy()
    weights = np.zeros((count, len(model["bone_parents"])), np.float32)
    np.add.at(weights, (np.arange(count)[:, None], model["skin_bones"]), model["skin_weights"])
    regressor = np.zeros((weights.shape[1], count), np.float32)
    offsets = model["joint_regressor_offsets"]
    for joint in range(len(regressor)):
        row = slice(offsets[joint], offsets[joint + 1])
        regressor[joint, model["joint_regressor_vertices"][row]] = model["joint_regressor_values"][row]
    # As the library does: the joints of the space are found once.
    joint_mean = regressor @ mean
    joint_basis = np.einsum("jv,vak->jak", regressor, basis.reshape(count, 3, -1))
    identity, pose = (np.array(line.split(","), float) for line in (export / "parameters.csv").read_text().splitlines())
    identity = identity.astype(np.float32)

    def turn(vector):
        angle = np.linalg.norm(vector)
        x, y, z = vector / (angle or 1.0)
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew

    def transforms(joints):
        rotations, places = [turn(pose[3:6])], [joints[0] + pose[:3]]
        for bone in range(1, len(joints)):
            parent = model_parents[bone]
            rotation = rotations[parent]
            places.append(places[parent] + rotation @ (joints[bone] - joints[parent]))
            for axis in np.flatnonzero(axis_bones == bone):
                rotation = rotation @ turn(axis_directions[axis] * pose[6 + axis])
            rotations.append(rotation)
        return [np.c_[r, p - r @ j].ravel() for r, p, j in zip(rotations, places, joints)]

    model_parents, axis_bones = model["bone_parents"], model["axis_bones"]
    axis_directions = model["axis_directions"].astype(float)

    def skin(rest, bones):
        blended = (weights @ bones).reshape(count, 3, 4)
        return np.einsum("vij,vj->vi", blended[:, :, :3], rest) + blended[:, :, 3]

    def rest_of(coefficients):
        return mean + (basis @ coefficients).reshape(count, 3)

    def joints_of(coefficients):
        return (joint_mean + joint_basis @ coefficients).astype(float)

    def whole():
        return skin(rest_of(identity), np.array(transforms(joints_of(identity)), np.float32))

    rest = rest_of(identity)
    bones = np.array(transforms(joints_of(identity)), np.float32)
    expected, _ = read_ply(export / "posed_body.ply")
    difference = np.linalg.norm(whole() - expected, axis=1).max()
    # A skeleton in interpreted Python is slow and would flatter us: with fixed identity only the skinning is timed.
    return [("numpy, skinning alone", best_ms(lambda: skin(rest, bones)), ours["skinning; fixed identity"], difference),
            ("numpy, identity, skeleton and skinning", best_ms(whole), ours["skinning; with identity"], difference)]


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        measure(Path(sys.argv[2]))
    else:
        main()
