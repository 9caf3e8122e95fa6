"""The 15-bone rig: skin weights, joint regressor, axes with limits, and named vertices."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.optimize import least_squares, nnls

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


def fit_joint_regressor(vertices, joints, mirror, *, candidates=90, ridge=2e-3):
    """Sparse rows (offsets, vertices, values): non-negative, symmetric, each row sums to one.

    ``vertices`` (bodies, V, 3) and ``joints`` (bodies, 15, 3). Each joint is fitted by non-negative least squares over
    the vertices nearest to it, with a small ridge that spreads the weights round the limb.
    """
    mean_vertices, mean_joints = vertices.mean(0), joints.mean(0)
    rows = [None] * len(BONES)
    for bone, twin in enumerate(BONE_MIRROR):
        if bone > twin:
            continue
        distance = np.linalg.norm(mean_vertices - mean_joints[bone], axis=1)
        near = np.argsort(distance, kind="stable")[:candidates]
        if bone == twin:
            near = np.unique(np.concatenate([near, mirror[near]]))
            columns = 0.5 * (vertices[:, near] + mirrored(vertices[:, mirror[near]]))
        else:
            columns = vertices[:, near]
        spread = columns - mean_joints[bone]
        wanted = joints[:, bone] - mean_joints[bone]
        matrix = np.moveaxis(spread, 1, 2).reshape(-1, len(near))
        scale = np.sqrt(len(vertices))
        system = np.concatenate([matrix, 10 * scale * np.ones((1, len(near))), ridge * scale * np.eye(len(near))])
        goal = np.concatenate([wanted.ravel(), [10 * scale], np.zeros(len(near))])
        values, _ = nnls(system, goal, maxiter=50 * len(near))
        values[values < 2e-3] = 0
        table = np.zeros(len(mean_vertices))
        table[near] = values / values.sum()
        if bone == twin:
            table = 0.5 * (table + table[mirror])
        rows[bone] = table
        if bone != twin:
            rows[twin] = table[mirror]
    offsets, indices, numbers = [0], [], []
    for row in rows:
        used = np.flatnonzero(row)
        indices.append(used)
        numbers.append(row[used] / row[used].sum())
        offsets.append(offsets[-1] + len(used))
    return (
        np.array(offsets, dtype=np.int32),
        np.concatenate(indices).astype(np.int32),
        np.concatenate(numbers).astype(np.float32),
    )


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
        return [Axis(f"{side}_{name}", BONES.index(f"{side}_{bone}"), turn(axis), span) for name, bone, axis, span in rows]

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


# ---------------------------------------------------------------- posing (for pictures and example poses)


def rotation(axis, angle):
    axis = unit(axis)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def bone_transforms(joints, axes, angles):
    """Rotation and translation that carry rest points of every bone to their posed place."""
    rotations, translations = [], []
    for bone, parent in enumerate(PARENTS):
        local = np.eye(3)
        for axis, angle in zip(axes, angles):
            if axis.bone == bone:
                local = local @ rotation(axis.direction, angle)
        shift = joints[bone] - local @ joints[bone]
        if parent >= 0:
            shift = rotations[parent] @ shift + translations[parent]
            local = rotations[parent] @ local
        rotations.append(local)
        translations.append(shift)
    return np.array(rotations), np.array(translations)


def skin(vertices, rotations, translations, bones, weights):
    moved = np.zeros_like(vertices)
    for slot in range(bones.shape[1]):
        chosen = bones[:, slot]
        moved += weights[:, slot, None] * (
            np.einsum("vij,vj->vi", rotations[chosen], vertices) + translations[chosen]
        )
    return moved


# Directions of the left upper arm, left forearm, left thigh and left shank in named example poses.
EXAMPLE_DIRECTIONS = {
    "arms_down": ([0.12, -1, 0.0], [0.05, -1, 0.22], None, None),
    "t_pose": ([1, 0, 0], [1, 0, 0], None, None),
    "arms_forward": ([0.1, 0, 1], [0, 0, 1], None, None),
    "arms_up": ([0.15, 1, 0.05], [0.05, 1, 0.05], None, None),
    "seated": ([0.12, -1, 0.1], [0, 0, 1], [0.15, 0, 1], [0, -1, 0]),
}


def example_poses(joints, axes):
    """24 angles for a few everyday poses, found by turning limbs towards wanted directions."""
    poses = {}
    for name, wanted in EXAMPLE_DIRECTIONS.items():
        angles = np.zeros(len(axes))
        for bone, child, direction in (
            ("left_upper_arm", "left_forearm", wanted[0]),
            ("left_forearm", "left_hand", wanted[1]),
            ("left_thigh", "left_shank", wanted[2]),
            ("left_shank", "left_foot", wanted[3]),
        ):
            if direction is not None:
                aim(joints, axes, angles, bone, child, unit(direction))
        for index, axis in enumerate(axes):
            if axis.name.startswith("right_"):
                angles[index] = angles[index - 5]  # the left side stands five places before
        poses[name] = [round(float(angle), 4) for angle in angles]
    return poses


def aim(joints, axes, angles, bone, child, direction):
    """Turn one bone (and, for a hinge, its parent's twist) until its child lies in ``direction``."""
    own = [k for k, axis in enumerate(axes) if axis.bone == BONES.index(bone)]
    twist = [k for k, axis in enumerate(axes) if axis.bone == PARENTS[BONES.index(bone)] and axis.name.endswith("_twist")]
    free = own[:2] if len(own) == 3 else own + twist
    low = np.radians([axes[k].limits[0] for k in free])
    high = np.radians([axes[k].limits[1] for k in free])

    def miss(values):
        angles[free] = values
        rotations, _ = bone_transforms(joints, axes, angles)
        reach = rotations[BONES.index(bone)] @ (joints[BONES.index(child)] - joints[BONES.index(bone)])
        return np.concatenate([unit(reach) - direction, 1e-3 * np.asarray(values)])

    angles[free] = least_squares(miss, np.clip(angles[free], low + 1e-6, high - 1e-6), bounds=(low, high)).x


def part_labels(mean, bones, weights, measuring):
    """0 usually covered, 1 head above the neck, 2 hands, 3 feet."""
    share = np.zeros((len(mean), len(BONES)))
    for slot in range(4):
        np.add.at(share, (np.arange(len(mean)), bones[:, slot].astype(int)), weights[:, slot])
    labels = np.zeros(len(mean), dtype=np.uint8)
    chin, nape = mean[measuring["chin"]], mean[measuring["neck_base"]]
    # A plane from under the chin to the hair line at the back of the neck.
    collar = (mean[:, 1] - (chin[1] - 0.01)) - 0.15 * (chin[2] - mean[:, 2])
    labels[(share[:, BONES.index("head")] > 0.5) & (collar > 0) & (mean[:, 1] > nape[1])] = 1
    labels[share[:, [BONES.index("left_hand"), BONES.index("right_hand")]].sum(1) > 0.5] = 2
    labels[share[:, [BONES.index("left_foot"), BONES.index("right_foot")]].sum(1) > 0.5] = 3
    return labels


# ---------------------------------------------------------------- named vertices

LANDMARKS = (
    "forehead left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist "
    "left_knee right_knee left_toe right_toe left_heel right_heel abdomen"
).split()


class VertexPicker:
    """Finds named vertices on the mean body from joints and directions."""

    def __init__(self, mean, mirror, joints, main_bone):
        self.mean, self.mirror, self.joints, self.main_bone = mean, mirror, joints, main_bone
        self.middle = np.flatnonzero(mirror == np.arange(len(mirror)))

    def joint(self, name):
        return self.joints[BONES.index(name)]

    def on(self, *bones):
        return np.flatnonzero(np.isin(self.main_bone, [BONES.index(bone) for bone in bones]))

    def extreme(self, candidates, direction):
        return int(candidates[np.argmax(self.mean[candidates] @ np.asarray(direction, float))])

    def near(self, point, radius, candidates=None):
        candidates = np.arange(len(self.mean)) if candidates is None else candidates
        return candidates[np.linalg.norm(self.mean[candidates] - point, axis=1) < radius]

    def nearest(self, point, candidates=None):
        candidates = np.arange(len(self.mean)) if candidates is None else candidates
        return int(candidates[np.argmin(np.linalg.norm(self.mean[candidates] - point, axis=1))])

    def level(self, height, tolerance, candidates):
        return candidates[np.abs(self.mean[candidates, 1] - height) < tolerance]
