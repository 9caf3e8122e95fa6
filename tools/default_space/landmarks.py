"""Named vertices of the template: the 14 fitting landmarks and the points measurements start from."""

import numpy as np

from rig import BONES, unit

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

    def ring(self, point, along, half_height, radius):
        """Vertices near a point and near the plane through it across the limb."""
        offset = self.mean - point
        return np.flatnonzero((np.abs(offset @ unit(along)) < half_height) & (np.linalg.norm(offset, axis=1) < radius))

    def nearest(self, point, candidates=None):
        candidates = np.arange(len(self.mean)) if candidates is None else candidates
        return int(candidates[np.argmin(np.linalg.norm(self.mean[candidates] - point, axis=1))])

    def level(self, height, tolerance, candidates):
        return candidates[np.abs(self.mean[candidates, 1] - height) < tolerance]


def pick_vertices(pick: VertexPicker, hand_points, navel, nipple, eye_height):
    """Both tables as dictionaries of vertex indices; the right side is the mirror image of the left."""
    mean, joint = pick.mean, pick.joint
    left = np.flatnonzero(mean[:, 0] > 1e-6)
    front, back = np.array([0, 0, 1.0]), np.array([0, 0, -1.0])
    index_knuckle, little_knuckle, _ = hand_points
    points = {}

    hip, knee, ankle = joint("left_thigh"), joint("left_shank"), joint("left_foot")
    shoulder, elbow, wrist = joint("left_upper_arm"), joint("left_forearm"), joint("left_hand")
    foot = pick.on("left_foot")
    low_foot = foot[mean[foot, 1] < mean[foot, 1].min() + 0.03]
    trunk = pick.on("pelvis", "thorax")
    head = pick.on("head")

    points["left_toe"] = pick.extreme(foot, front)
    points["left_heel"] = pick.extreme(foot, back)
    points["left_heel_sole"] = pick.extreme(low_foot[mean[low_foot, 2] < ankle[2]], [0, -1, -0.15])
    points["left_ankle"] = pick.extreme(pick.near(ankle, 0.07), [1, 0.1, 0])
    points["left_knee"] = pick.extreme(pick.ring(knee, ankle - hip, 0.03, 0.12), front)
    points["left_mid_thigh"] = pick.extreme(pick.ring(0.5 * (hip + knee), knee - hip, 0.02, 0.15), front)
    points["left_hip"] = pick.extreme(
        pick.level(hip[1], 0.06, np.intersect1d(left, pick.on("pelvis", "left_thigh"))), [1, 0, 0]
    )

    bend = -unit(unit(shoulder - elbow) + unit(wrist - elbow))
    points["left_elbow"] = pick.extreme(pick.near(elbow, 0.07), bend)
    ulnar = unit(little_knuckle - index_knuckle)
    points["left_wrist"] = pick.extreme(pick.near(wrist, 0.045), ulnar)
    acromion = pick.near(shoulder, 0.09)
    points["left_acromion"] = pick.extreme(acromion, [0.35, 1, 0])
    points["left_shoulder"] = points["left_acromion"]
    arm_side = unit(elbow - shoulder)
    outer = unit(np.array([1.0, 0, 0]) - arm_side[0] * arm_side)
    points["left_mid_upper_arm"] = pick.extreme(pick.ring(0.5 * (shoulder + elbow), arm_side, 0.015, 0.1), outer)
    points["left_axilla"] = axilla(pick, shoulder, elbow)
    points["left_nipple"] = nipple

    points["crown"] = pick.extreme(np.arange(len(mean)), [0, 1, 0])
    points["forehead"] = pick.extreme(pick.level(eye_height + 0.055, 0.015, np.intersect1d(pick.middle, head)), front)
    points["abdomen"] = points["navel"] = navel
    jaw = pick.level(eye_height - 0.11, 0.025, np.intersect1d(pick.middle, head))
    points["chin"] = pick.extreme(jaw, [0, -0.6, 1])
    nape = pick.level(joint("head")[1] - 0.005, 0.02, pick.middle)
    points["neck_base"] = pick.extreme(nape, back)
    front_middle = pick.middle[(mean[pick.middle, 1] < hip[1] + 0.1)]
    crotch = front_middle[np.abs(mean[front_middle, 2] - hip[2]) < 0.06]
    points["crotch"] = pick.extreme(crotch, [0, -1, 0])
    points["left_waist"] = narrowest_side(pick, np.intersect1d(left, trunk), mean[navel, 1])

    for name in [name for name in points if name.startswith("left_")]:
        points[name.replace("left_", "right_")] = int(pick.mirror[points[name]])
    points = {name: int(vertex) for name, vertex in points.items()}
    fitting = np.array([points[name] for name in LANDMARKS], dtype=np.int32)
    measuring = {
        name: vertex
        for name, vertex in sorted(points.items())
        if name not in ("forehead", "abdomen", "left_shoulder", "right_shoulder", "left_toe", "right_toe")
    }
    return fitting, measuring


def axilla(pick, shoulder, elbow):
    """A vertex in the fold between chest and arm, a quarter down the upper arm and towards the trunk."""
    fold = shoulder + 0.25 * (elbow - shoulder) + np.array([-0.05, -0.06, 0.0])
    around = pick.near(shoulder + np.array([-0.02, -0.09, 0.0]), 0.07)
    offset = pick.mean[around] - shoulder
    inner = around[(offset[:, 1] < -0.03) & (np.abs(offset[:, 2]) < 0.03)]
    return pick.nearest(fold, inner if len(inner) else around)


def narrowest_side(pick, candidates, navel_height):
    """Side vertex at the height where the trunk, seen from the front, is narrowest."""
    best, best_width = None, np.inf
    for height in np.arange(navel_height - 0.02, navel_height + 0.14, 0.01):
        level = pick.level(height, 0.012, candidates)
        vertex = pick.extreme(level, [1, 0, 0])
        width = pick.mean[vertex, 0]
        if width < best_width:
            best, best_width = vertex, width
    return best


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
