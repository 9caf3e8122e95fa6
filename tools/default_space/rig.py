"""The 15-bone rig: skin weights, joint regressor, and axes with limits."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.optimize import nnls

from source import Source

BONES = (
    "pelvis left_thigh left_shank left_foot right_thigh right_shank right_foot thorax head "
    "left_upper_arm left_forearm left_hand right_upper_arm right_forearm right_hand"
).split()
PARENTS = np.array([-1, 0, 1, 2, 0, 4, 5, 0, 7, 7, 9, 10, 7, 12, 13])
BONE_MIRROR = np.array([0, 4, 5, 6, 1, 2, 3, 7, 8, 12, 13, 14, 9, 10, 11])

# Joint of every bone as a mixture of the source's joint cubes (right side by mirroring).
JOINT_CUBES = {
    "pelvis": {"pelvis": 1.0},
    "left_thigh": {"l-upper-leg": 1.0},
    "left_shank": {"l-knee": 1.0},
    "left_foot": {"l-ankle": 1.0},
    "thorax": {"spine-3": 0.6, "spine-2": 0.4},
    "head": {"neck": 1.0},
    "left_upper_arm": {"l-shoulder": 1.0},
    "left_forearm": {"l-elbow": 1.0},
    "left_hand": {"l-hand": 1.0},
}

# Shares of a source bone's weight; a source bone matches by the longest prefix of its name without side.
BONE_SHARES = {
    "root": {"pelvis": 1.0},
    "pelvis": {"pelvis": 1.0},
    "spine05": {"pelvis": 0.9, "thorax": 0.1},
    "spine04": {"pelvis": 0.65, "thorax": 0.35},
    "spine03": {"pelvis": 0.35, "thorax": 0.65},
    "spine02": {"pelvis": 0.08, "thorax": 0.92},
    "spine01": {"thorax": 1.0},
    "breast": {"thorax": 1.0},
    "clavicle": {"thorax": 0.85, "upper_arm": 0.15},
    "shoulder01": {"thorax": 0.5, "upper_arm": 0.5},
    "upperarm": {"upper_arm": 1.0},
    "lowerarm": {"forearm": 1.0},
    "wrist": {"hand": 1.0},
    "metacarpal": {"hand": 1.0},
    "finger": {"hand": 1.0},
    "upperleg": {"thigh": 1.0},
    "lowerleg": {"shank": 1.0},
    "foot": {"foot": 1.0},
    "toe": {"foot": 1.0},
    "neck01": {"thorax": 0.65, "head": 0.35},
    "neck02": {"thorax": 0.3, "head": 0.7},
    "neck03": {"thorax": 0.08, "head": 0.92},
}
SIDED = {"upper_arm", "forearm", "hand", "thigh", "shank", "foot"}


def mirrored(points):
    return points * np.array([-1.0, 1.0, 1.0])


def mirrored_axis(axis):
    """Mirror image of a turning direction (an axial vector)."""
    return np.asarray(axis) * np.array([1.0, -1.0, -1.0])


# ---------------------------------------------------------------- weights


def skin_weights(source: Source, template, smoothing_rounds=4):
    """(V, 4) bone indices and weights from the source rig's weights, smoothed over the surface."""
    dense = np.zeros((len(source.positions), len(BONES)))
    for name, entries in source.rig_weights().items():
        stem, _, side = name.partition(".")
        matches = [prefix for prefix in BONE_SHARES if stem.startswith(prefix)]
        shares = BONE_SHARES[max(matches, key=len)] if matches else {"head": 1.0}
        for bone, share in shares.items():
            if bone in SIDED:
                bone = ("left_" if side == "L" else "right_") + bone
            column = BONES.index(bone)
            for vertex, weight in entries:
                dense[vertex, column] += share * weight
    dense /= np.maximum(dense.sum(1, keepdims=True), 1e-9)
    weights = template.from_source @ dense
    average = neighbour_average(template.faces, template.vertex_count)
    for _ in range(smoothing_rounds):
        weights = 0.5 * weights + 0.5 * (average @ weights)
    weights = 0.5 * (weights + weights[template.mirror][:, BONE_MIRROR])
    return four_largest(weights, template.mirror)


def four_largest(weights, mirror):
    weights = np.where(weights < 0.01, 0.0, weights)
    order = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    kept = np.zeros_like(weights)
    np.put_along_axis(kept, order, np.take_along_axis(weights, order, 1), 1)
    kept = 0.5 * (kept + kept[mirror][:, BONE_MIRROR])
    order = np.argsort(-kept, axis=1, kind="stable")[:, :4]
    values = np.take_along_axis(kept, order, 1)
    values /= values.sum(1, keepdims=True)
    return np.where(values > 0, order, 0).astype(np.uint8), values.astype(np.float32)


def neighbour_average(faces, count):
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    links = sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    return sparse.diags(1 / np.asarray(links.sum(1)).ravel()) @ links


# ---------------------------------------------------------------- joints


def joint_points(source: Source) -> sparse.csr_matrix:
    """(15, source vertices) matrix that gives the anatomical joints of any source body."""
    matrix = sparse.lil_matrix((len(BONES), len(source.positions)))
    for bone, mixture in JOINT_CUBES.items():
        for cube, share in mixture.items():
            for vertex in source.joint_cube(cube):
                matrix[BONES.index(bone), vertex] += share / 8
            if bone.startswith("left_"):
                for vertex in source.joint_cube(cube.replace("l-", "r-", 1)):
                    matrix[BONES.index(bone.replace("left_", "right_")), vertex] += share / 8
    return matrix.tocsr()


# Ring of a joint: vertices within this distance of it and within this half-height of the plane through it (metres).
RING = {
    "pelvis": (0.24, 0.05),
    "thorax": (0.24, 0.05),
    "head": (0.13, 0.03),
    "thigh": (0.17, 0.06),
    "shank": (0.12, 0.05),
    "foot": (0.09, 0.03),
    "upper_arm": (0.13, 0.05),
    "forearm": (0.09, 0.035),
    "hand": (0.06, 0.025),
}


# The knee cubes of the source's height targets do not follow the surface (they are off by up to 7 cm), so the knee is
# fitted to the mean body alone.
FITTED_TO_MEAN = {"left_shank"}


def fit_joint_regressor(vertices, joints, mirror, evenness=0.03):
    """Sparse rows (offsets, vertices, values): non-negative, symmetric, each row sums to one.

    Each joint is an average over a ring of vertices round the limb that hits the anatomical joint of the mean body and
    follows those of ``vertices`` (bodies, V, 3) and ``joints`` (bodies, 15, 3); ``evenness`` spreads the weights.
    """
    mean_vertices, mean_joints = vertices.mean(0), joints.mean(0)
    rows = [None] * len(BONES)
    for bone, twin in enumerate(BONE_MIRROR):
        if bone > twin:
            continue
        reach, half_height = RING[BONES[bone].removeprefix("left_")]
        offset = mean_vertices - mean_joints[bone]
        along = ring_normal(mean_joints, bone)
        ring = np.flatnonzero((np.linalg.norm(offset, axis=1) < reach) & (np.abs(offset @ along) < half_height))
        spread = vertices[:, ring] - joints[:, None, bone]
        if bone == twin:
            spread = 0.5 * (spread + mirrored(vertices[:, mirror[ring]] - joints[:, None, bone]))
        if BONES[bone] in FITTED_TO_MEAN:
            spread = spread.mean(0, keepdims=True)
        table = np.zeros(len(mean_vertices))
        table[ring] = even_average(spread, evenness)
        if bone == twin:
            table = 0.5 * (table + table[mirror])
        rows[bone], rows[twin] = table, table[mirror]
    used = [np.flatnonzero(row) for row in rows]
    return (
        np.concatenate([[0], np.cumsum([len(part) for part in used])]).astype(np.int32),
        np.concatenate(used).astype(np.int32),
        np.concatenate([row[part] for row, part in zip(rows, used)]).astype(np.float32),
    )


def ring_normal(joints, bone):
    """Direction of the limb at a joint: upright for the trunk, between both bones elsewhere."""
    name = BONES[bone]
    if not name.startswith("left_"):
        return np.array([0.0, 1.0, 0.0])
    children = [child for child, parent in enumerate(PARENTS) if parent == bone]
    after = joints[children[0]] - joints[bone] if children else None
    before = joints[bone] - joints[PARENTS[bone]]
    if name in ("left_thigh", "left_upper_arm"):
        return unit(after)
    return unit(before) if after is None else unit(unit(before) + unit(after))


def even_average(offsets, evenness):
    """Non-negative weights with sum one; their averages of ``offsets`` (bodies, n, 3) are small, zero in the mean."""
    bodies, count, _ = offsets.shape
    follow = np.moveaxis(offsets - offsets.mean(0), 1, 2).reshape(-1, count) / np.sqrt(bodies)
    hit = np.concatenate([1e2 * offsets.mean(0).T, 1e2 * np.ones((1, count))])
    system = np.concatenate([follow, hit, evenness * np.eye(count)])
    goal = np.zeros(len(system))
    goal[len(follow) + 3] = 1e2
    values, _ = nnls(system, goal, maxiter=50 * count)
    values[values < 1e-3] = 0
    return values / values.sum()


def regressor_matrix(regressor, vertex_count):
    offsets, indices, values = regressor
    return sparse.csr_matrix((values.astype(float), indices, offsets), shape=(len(offsets) - 1, vertex_count))


# ---------------------------------------------------------------- axes


@dataclass
class Axis:
    name: str
    bone: int
    direction: np.ndarray
    limits: tuple[float, float]  # degrees


def unit(vector):
    vector = np.asarray(vector, dtype=float)
    return vector / np.linalg.norm(vector)


def across(vector, along):
    """The part of ``vector`` at right angles to ``along``, as a unit vector."""
    return unit(vector - np.dot(vector, along) * along)


# The shoulder's first axis: an upper arm can hardly point along it or against it (up-back-outward, and far across the
# chest), so that the first and the third axis hardly ever line up.
LEFT_SHOULDER_POLE = unit([-0.5, -0.5, 0.7])


def build_axes(joints, hand_points) -> list[Axis]:
    """The 24 axes. ``hand_points``: index knuckle, little knuckle, thumb tip of the left hand in the mean body."""
    left = {name: joints[BONES.index("left_" + name)] for name in ("thigh", "shank", "upper_arm", "forearm", "hand")}
    thigh = unit(left["shank"] - left["thigh"])
    upper_arm = unit(left["forearm"] - left["upper_arm"])
    forearm = unit(left["hand"] - left["forearm"])
    rest_elbow = np.degrees(np.arccos(np.dot(upper_arm, forearm)))
    index_knuckle, little_knuckle, thumb_tip = hand_points
    hand = unit(0.5 * (index_knuckle + little_knuckle) - left["hand"])
    wrist = across(index_knuckle - little_knuckle, hand)
    palmar = np.cross(wrist, hand)
    if np.dot(palmar, thumb_tip - left["hand"]) < 0:
        wrist = -wrist
    swing = across(np.cross(LEFT_SHOULDER_POLE, upper_arm), LEFT_SHOULDER_POLE)
    if np.dot(np.cross(swing, upper_arm), LEFT_SHOULDER_POLE) < 0:
        swing = -swing

    lateral, up, forward = np.eye(3)
    leg = [
        ("hip_flexion", "thigh", -lateral, (-30, 130)),
        ("hip_abduction", "thigh", forward, (-35, 60)),
        ("hip_twist", "thigh", -thigh, (-50, 50)),
        ("knee_flexion", "shank", across(lateral, thigh), (-5, 150)),
        ("ankle_flexion", "foot", -lateral, (-50, 35)),
    ]
    arm = [
        ("shoulder_elevation", "upper_arm", LEFT_SHOULDER_POLE, (-80, 150)),
        ("shoulder_swing", "upper_arm", swing, (-75, 80)),
        ("shoulder_twist", "upper_arm", upper_arm, (-90, 90)),
        ("elbow_flexion", "forearm", unit(np.cross(upper_arm, forearm)), (-rest_elbow - 5, 150 - rest_elbow)),
        ("wrist_flexion", "hand", wrist, (-75, 80)),
    ]
    trunk = [
        Axis("thorax_twist", BONES.index("thorax"), up, (-50, 50)),
        Axis("thorax_bend", BONES.index("thorax"), -forward, (-45, 45)),
        Axis("thorax_flexion", BONES.index("thorax"), lateral, (-40, 85)),
        Axis("neck_flexion", BONES.index("head"), lateral, (-55, 55)),
    ]

    def sided(side, rows):
        turn = mirrored_axis if side == "right" else np.asarray
        return [
            Axis(f"{side}_{name}", BONES.index(f"{side}_{bone}"), turn(axis), span) for name, bone, axis, span in rows
        ]

    return sided("left", leg) + sided("right", leg) + trunk + sided("left", arm) + sided("right", arm)


AXIS_SIGNS = {
    "hip_flexion": "positive lifts the knee forward",
    "hip_abduction": "positive moves the leg away from the other leg",
    "hip_twist": "positive turns the toes outward",
    "knee_flexion": "positive brings the heel to the buttock",
    "ankle_flexion": "positive lifts the toes",
    "thorax_twist": "positive turns the chest to the person's left",
    "thorax_bend": "positive bends to the person's left",
    "thorax_flexion": "positive bows forward",
    "neck_flexion": "positive brings the chin to the chest",
    "shoulder_elevation": "positive raises the arm outward, forward and up",
    "shoulder_swing": "positive brings the arm forward and across the chest",
    "shoulder_twist": "about the upper arm's long axis from shoulder to elbow, mirrored on the right",
    "elbow_flexion": "positive brings the hand to the shoulder; zero is the rest bend",
    "wrist_flexion": "positive brings the palm to the forearm",
}
