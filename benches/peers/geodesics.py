#!/usr/bin/env python3
"""Bounded geodesic distances beside potpourri3d's heat method, from the same sources of the same mesh, in one run.

    python3 benches/peers/geodesics.py [--mesh FILE] [--environment FOLDER]

Runs `cargo run --release -p habitus-geometry --example geodesics`, installs potpourri3d from PyPI into an environment of its
own, and prints times and differences within 3 cm. Edge-flip geodesics of a few pairs say who is right. One thread each.
"""
import argparse
import os
import subprocess
import sys
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PEERS = ["numpy==2.2.6", "potpourri3d==1.4.0"]
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}
CHECKED_PAIRS = 400


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh", type=Path, help="a mesh in metres [default: a made-up ring of folds]")
    parser.add_argument("--environment", type=Path, default=ROOT / "target" / "peers_geodesics")
    arguments = parser.parse_args()
    python = environment(arguments.environment)
    export = arguments.environment / "export"
    command = ["cargo", "run", "--quiet", "--release", "-p", "habitus-geometry", "--example", "geodesics", "--", export]
    ours = subprocess.run(command + ([arguments.mesh] if arguments.mesh else []), cwd=ROOT, env={**os.environ, **ONE_THREAD})
    if ours.returncode != 0:
        sys.exit("geodesics: the example failed")
    sys.exit(subprocess.run([python, __file__, "--measure", export], env={**os.environ, **ONE_THREAD}).returncode)


def environment(folder):
    """Python of an environment that has the peer; made on first use."""
    python = folder / "bin" / "python"
    if not python.exists():
        print(f"installing {', '.join(PEERS)} into {folder}", flush=True)
        venv.create(folder, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PEERS], check=True)
    return python


def measure(export):
    import numpy as np
    import potpourri3d as pp3d

    vertices, faces = pp3d.read_mesh(str(export / "mesh.obj"))
    table = np.loadtxt(export / "distances.csv", delimiter=",", skiprows=1)
    ours = float((export / "seconds_per_source.txt").read_text())
    begin = time.perf_counter()
    solver = pp3d.MeshHeatMethodDistanceSolver(vertices, faces)
    setup = time.perf_counter() - begin
    sources, seconds, differences = np.unique(table[:, 0].astype(int)), [], []
    for source in sources:
        begin = time.perf_counter()
        heat = solver.compute_distance(source)
        seconds.append(time.perf_counter() - begin)
        rows = table[table[:, 0] == source]
        differences.append(np.abs(heat[rows[:, 1].astype(int)] - rows[:, 2]))
    differences = 1000 * np.concatenate(differences)
    flips = pp3d.EdgeFlipGeodesicSolver(vertices, faces)
    apart = table[table[:, 2] > 0]
    pairs = apart[np.linspace(0, len(apart) - 1, CHECKED_PAIRS).astype(int)]
    shorter = []
    for source, vertex, distance in pairs:
        path = flips.find_geodesic_path(int(source), int(vertex))
        shorter.append(distance - np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    heat = float(np.min(seconds))
    print(f"heat method: {1e3 * setup:.0f} ms once, {1e6 * heat:.0f} µs a source (fastest of {len(sources)}), whole mesh")
    print(f"heat against ours within 3 cm: mean {differences.mean():.2f} mm, worst {differences.max():.2f} mm")
    shorter = 1000 * np.array(shorter)
    print(f"ours minus edge-flip paths (local shortest) of {len(pairs)} pairs: largest {shorter.max():.1e} mm")
    print(f"ours is {heat / ours:.0f} times as fast a source")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        measure(Path(sys.argv[2]))
    else:
        main()
