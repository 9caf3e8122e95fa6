#!/usr/bin/env python3
"""Registration of raw scans beside trimesh's nricp_sumner and nricp_amberg, on the same scans with the same 64 landmarks, in one run.

    python3 benches/peers/register.py [--scans N] [--points N] [--habitus FILE] [--environment FOLDER]

Generates scans with `habitus generate scans`, so that the true place of every vertex is known, registers them with
`habitus register` and with trimesh (its defaults, after the rigid alignment of the landmarks), and prints time and vertex
error of each and their ratios. trimesh is installed from PyPI into an environment of its own; nothing here is part of the
product. Time is that of one core: theirs from the meshes in memory to the registered vertices, ours of the whole program
over the number of scans, with reading, measuring and writing.
"""
import argparse
import os
import shutil
import subprocess
import sys
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PEERS = ["numpy==2.2.6", "scipy==1.15.3", "rtree==1.4.1", "trimesh==4.8.3"]
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=3, help="how many scans [default: 3]")
    parser.add_argument("--points", type=int, default=20_000, help="points of a scan [default: 20000]")
    parser.add_argument("--habitus", type=Path, help="the program [default: built with cargo build --release]")
    parser.add_argument("--environment", type=Path, default=ROOT / "target" / "peers_register")
    arguments = parser.parse_args()
    python = environment(arguments.environment)
    habitus = arguments.habitus or built()
    lab, run = arguments.environment / "lab", arguments.environment / "run"
    shutil.rmtree(lab, ignore_errors=True)
    generate = [habitus, "generate", "scans", "-o", lab, "--count", str(arguments.scans), "--points", str(arguments.points)]
    subprocess.run(generate, check=True, stdout=subprocess.DEVNULL)
    command = [python, __file__, "--measure", habitus, lab, run, str(arguments.scans)]
    sys.exit(subprocess.run(command, env={**os.environ, **ONE_THREAD}).returncode)


def built():
    subprocess.run(["cargo", "build", "--quiet", "--release", "-p", "habitus-cli"], cwd=ROOT, check=True)
    return ROOT / "target" / "release" / ("habitus.exe" if os.name == "nt" else "habitus")


def environment(folder):
    """Python of an environment that has the peer; made on first use."""
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    probe = [python, "-c", "import numpy, scipy, rtree, trimesh"]
    if python.exists() and subprocess.run(probe, capture_output=True).returncode == 0:
        return python
    print(f"installing {', '.join(PEERS)} into {folder}", flush=True)
    venv.create(folder, with_pip=True)
    if subprocess.run([python, "-m", "pip", "install", "--quiet", "--retries", "1", *PEERS]).returncode != 0:
        sys.exit("register: the peer cannot be installed: is there a network, and a wheel for this Python (3.10 to 3.13)?")
    return python


def measure(habitus, lab, run, count):
    import numpy as np
    import trimesh

    rows = {}

    def add(peer, seconds, vertices, truth):
        error = 1e3 * np.linalg.norm(vertices - truth, axis=1)
        rows.setdefault(peer, []).append((seconds, error.mean(), np.percentile(error, 95)))

    template = trimesh.load(lab / "template.ply", process=False)
    table = dict(line.rsplit(",", 1) for line in (lab / "template_landmarks.csv").read_text().splitlines()[1:])
    seconds = ours(habitus, lab, run, count)
    for number in range(count):
        name = f"subject_{number:04}"
        truth = np.asarray(trimesh.load(lab / "truth" / f"{name}.ply", process=False).vertices)
        found = trimesh.load(run / "1_register" / f"{name}.ply", process=False)
        add("habitus register", seconds, np.asarray(found.vertices), truth)
        scan = trimesh.load(lab / "scans" / f"{name}.ply", process=False)
        lines = [line.rsplit(",", 3) for line in (lab / "landmarks" / f"{name}.csv").read_text().splitlines()[1:]]
        marked = [(int(table[line[0]]), [float(value) for value in line[1:]]) for line in lines if line[0] in table]
        landmarks = np.array([vertex for vertex, _ in marked])
        targets = np.array([place for _, place in marked])
        start = rigidly(np.asarray(template.vertices), landmarks, targets)
        for peer in ("nricp_sumner", "nricp_amberg"):
            source = trimesh.Trimesh(start, template.faces, process=False)
            # The peer's tree of the scan is part of its work: a fresh mesh each time.
            target = trimesh.Trimesh(scan.vertices, scan.faces, process=False)
            begin = time.process_time()
            found = getattr(trimesh.registration, peer)(source, target, source_landmarks=landmarks, target_positions=targets)
            add(f"trimesh {peer}", time.process_time() - begin, np.asarray(found), truth)
    print_table(rows, np, len(landmarks))


def ours(habitus, lab, run, count):
    """Processor seconds a scan, the program's start and the template's preparation shared among all."""
    import resource

    command = [habitus, "register", lab / "scans", "-o", run, "--force", "--jobs", "1", "--landmarks", lab / "landmarks"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        command + ["--template-landmarks", lab / "template_landmarks.csv"], capture_output=True, text=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 3):
        sys.exit(f"register: habitus failed: {done.stderr}")
    return (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime) / count


def rigidly(points, landmarks, targets):
    """The points, moved rigidly so that their landmarks lie best on the targets (Kabsch)."""
    import numpy as np

    source, target = points[landmarks], targets
    u, _, vt = np.linalg.svd((source - source.mean(0)).T @ (target - target.mean(0)))
    turn = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    return (points - source.mean(0)) @ turn.T + target.mean(0)


def print_table(rows, np, landmarks):
    means = {peer: np.mean(values, axis=0) for peer, values in rows.items()}
    own = means["habitus register"]
    count = len(rows["habitus register"])
    print(f"{count} scans, {landmarks} landmarks on the last; means over scans")
    print(f"{'':24} {'CPU s':>8} {'mean mm':>8} {'p95 mm':>8} {'time':>8} {'mean':>6} {'p95':>6}  (over habitus)")
    for peer, mean in means.items():
        ratio = mean / own
        print(f"{peer:24} {mean[0]:8.2f} {mean[1]:8.2f} {mean[2]:8.2f} {ratio[0]:7.1f}x {ratio[1]:5.1f}x {ratio[2]:5.1f}x")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        measure(Path(sys.argv[2]), Path(sys.argv[3]), Path(sys.argv[4]), int(sys.argv[5]))
    else:
        main()
