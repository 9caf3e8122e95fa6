"""Linear blend skinning in numpy: for the common rest pose, example poses and pictures."""

import numpy as np
from scipy.optimize import least_squares

from rig import BONES, PARENTS, unit


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
        moved += weights[:, slot, None] * (np.einsum("vij,vj->vi", rotations[chosen], vertices) + translations[chosen])
    return moved


# Bones whose direction is brought to the common rest pose, with the bone whose joint ends them. Other bones keep their
# own direction in space (head, feet) or follow their parent (hands).
POSED_BONES = {
    "thorax": "head",
    **{
        f"{side}_{bone}": f"{side}_{child}"
        for side in ("left", "right")
        for bone, child in (
            ("thigh", "shank"),
            ("shank", "foot"),
            ("upper_arm", "forearm"),
            ("forearm", "hand"),
        )
    },
}
FOLLOWING_BONES = {"left_hand", "right_hand"}


def bone_directions(joints):
    """(…, posed bones, 3) unit directions of the bones that define the rest pose."""
    start = [BONES.index(bone) for bone in POSED_BONES]
    end = [BONES.index(child) for child in POSED_BONES.values()]
    directions = joints[..., end, :] - joints[..., start, :]
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def to_rest_pose(points, joints, wanted, bones, weights):
    """Turn every limb of one body by the smallest rotation that gives its bone the wanted direction.

    ``points`` (n, 3) with their skin ``bones`` and ``weights`` (n, 4); ``joints`` (15, 3).
    """
    directions = dict(zip(POSED_BONES, zip(bone_directions(joints), wanted)))
    rotations, translations = np.empty((len(BONES), 3, 3)), np.empty((len(BONES), 3))
    for bone, name in enumerate(BONES):
        parent = PARENTS[bone]
        if name in directions:
            rotations[bone] = smallest_rotation(*directions[name])
        elif name in FOLLOWING_BONES:
            rotations[bone] = rotations[parent]
        else:
            rotations[bone] = np.eye(3)
        moved_joint = joints[bone]
        if parent >= 0:
            moved_joint = rotations[parent] @ joints[bone] + translations[parent]
        translations[bone] = moved_joint - rotations[bone] @ joints[bone]
    return skin(points, rotations, translations, bones, weights)


def smallest_rotation(from_direction, to_direction):
    axis = np.cross(from_direction, to_direction)
    size = np.linalg.norm(axis)
    if size < 1e-9:
        return np.eye(3)
    return rotation(axis / size, np.arctan2(size, np.dot(from_direction, to_direction)))


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
    twist = [
        k for k, axis in enumerate(axes) if axis.bone == PARENTS[BONES.index(bone)] and axis.name.endswith("_twist")
    ]
    free = own[:2] if len(own) == 3 else own + twist
    low = np.radians([axes[k].limits[0] for k in free])
    high = np.radians([axes[k].limits[1] for k in free])

    def miss(values):
        angles[free] = values
        rotations, _ = bone_transforms(joints, axes, angles)
        reach = rotations[BONES.index(bone)] @ (joints[BONES.index(child)] - joints[BONES.index(bone)])
        return np.concatenate([unit(reach) - direction, 1e-3 * np.asarray(values)])

    angles[free] = least_squares(miss, np.clip(angles[free], low + 1e-6, high - 1e-6), bounds=(low, high)).x
