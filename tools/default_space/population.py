"""Adult bodies whose stature, mass and waist follow survey figures.

Each person is drawn from the survey's joint distribution; muscle, proportions, breast, ancestry and a hundred signed
details are drawn at random; then height, weight and waist attributes are solved so that the finished body has the
drawn stature, mass (volume × density) and waist.
"""

from dataclasses import dataclass

import numpy as np

from measure import BODY_DENSITY, Tape, statures, volumes
from shapes import SEXES, Detail, ShapeTargets, signed_details
from source import Source
from survey import draw_people

# Folder → standard deviation of a detail's coefficient (its targets are drawn at ±1).
BODY_DETAILS = {
    "arms": 0.16,
    "breast": 0.30,
    "buttocks": 0.35,
    "hip": 0.25,
    "legs": 0.16,
    "neck": 0.22,
    "pelvis": 0.30,
    "stomach": 0.25,
    "torso": 0.22,
    "hands": 0.20,
    "feet": 0.20,
    "head": 0.15,
    "chin": 0.25,
    "nose": 0.20,
    "cheek": 0.20,
    "ears": 0.15,
    "forehead": 0.15,
}
# Sideways shifts are not symmetric, a foot cannot leave its shank, and pregnancy is not part of this population.
LEFT_OUT = (
    "trans-in",
    "hip-trans",
    "torso-trans",
    "neck-trans",
    "head-trans",
    "foot-trans",
    "hand-trans",
    "valgus",
    "pregnant",
    "fingers-distance",
    "bulge",
    "cleft",
    "nipple",
    "ear-trans",
    "ear-rot",
    "ear-flap",
    "ear-wing",
)
# Folders and details that only the held-out bodies use, so that these lie outside the span of the training bodies.
HELD_OUT_FOLDERS = {"eyes": 0.35, "mouth": 0.25, "eyebrows": 0.4, "asym": 0.35}
HELD_OUT_DETAILS = {
    "stomach/stomach-pregnant": 0.25,
    "pelvis/bulge": 0.4,
    "legs/leg-valgus": 0.35,
    "hands/hand-fingers-distance": 0.3,
    "ears/ear-flap": 0.4,
    "ears/ear-wing": 0.4,
    "torso/torso-trans": 0.15,
    "head/head-trans": 0.15,
}
WAIST_DETAILS = {"torso/measure-waist-circ": 1.0, "stomach/stomach-tone": -0.5}
# The source's weight attribute ends at a body mass index of about 30; beyond it these details carry on.
FAT_DETAILS = {
    "arms/upperarm-fat": 0.30,
    "arms/upperarm-scale-horiz": 0.60,
    "arms/upperarm-scale-depth": 0.60,
    "arms/lowerarm-scale-horiz": 0.30,
    "legs/upperleg-fat": 0.10,
    "legs/upperleg-scale-horiz": 0.40,
    "legs/upperleg-scale-depth": 0.40,
    "legs/lowerleg-fat": 0.15,
    "legs/lowerleg-scale-horiz": 0.40,
    "buttocks/buttocks-volume": 0.15,
    "hip/hip-scale-horiz": 0.15,
    "hip/hip-scale-depth": 0.40,
    "torso/torso-scale-horiz": 0.25,
    "torso/torso-scale-depth": 0.60,
    "torso/measure-underbust-circ": 0.35,
    "torso/measure-bust-circ": 0.10,
    "neck/neck-scale-horiz": 0.35,
    "neck/neck-scale-depth": 0.35,
    "neck/neck-double": 0.40,
    "head/head-fat": 0.45,
}
LARGEST_WEIGHT = 1.1
FAT_STARTS_AT = 0.8


@dataclass
class Bodies:
    vertices: np.ndarray  # (n, V, 3) metres, source frame
    joints: np.ndarray  # (n, joint points, 3)
    sex: np.ndarray


def training_details(source: Source) -> list[Detail]:
    return [d for folder in BODY_DETAILS for d in signed_details(source, folder, LEFT_OUT)]


def held_out_details(source: Source) -> list[Detail]:
    extra = [d for folder in HELD_OUT_FOLDERS for d in signed_details(source, folder)]
    named = [d for folder in BODY_DETAILS for d in signed_details(source, folder) if d.name in HELD_OUT_DETAILS]
    known = {detail.name for detail in training_details(source)}
    return training_details(source) + extra + [detail for detail in named if detail.name not in known]


def detail_deviations(details: list[Detail]) -> np.ndarray:
    scale = BODY_DETAILS | HELD_OUT_FOLDERS
    return np.array([HELD_OUT_DETAILS.get(detail.name, scale[detail.name.split("/")[0]]) for detail in details])


def draw_attributes(sex: str, people, random) -> dict[str, np.ndarray]:
    count = len(people["age"])
    index = people["mass"] / people["stature"] ** 2
    muscle = (
        0.5 + (0.12 if sex == "male" else 0.0) - 0.003 * (people["age"] - 45) + 0.17 * random.standard_normal(count)
    )
    age = np.clip((people["age"] - 25) / 65, 0, 1)
    cup = 0.45 + 0.012 * (index - 27) + 0.18 * random.standard_normal(count)
    firmness = 0.5 - 0.004 * (people["age"] - 40) + 0.15 * random.standard_normal(count)
    return {
        "sex": np.full(count, float(SEXES.index(sex))),
        "age": age,
        "muscle": np.clip(muscle, 0.05, 1),
        "weight": np.full(count, 0.6),
        "height": np.full(count, 0.5),
        "proportions": np.clip(0.55 + 0.2 * random.standard_normal(count), 0, 1),
        "cup": np.clip(cup, 0, 1),
        "firmness": np.clip(firmness, 0.05, 0.95),
        "race": random.dirichlet([0.8, 0.8, 0.8], count),
    }


class BodyMaker:
    """Turns attributes into bodies of a wanted stature, mass and waist."""

    def __init__(self, shapes: ShapeTargets, faces, vertex_count: int, tape: Tape):
        self.shapes, self.faces, self.vertex_count, self.tape = shapes, faces, vertex_count, tape
        names = [detail.name for detail in shapes.details]
        self.waist = [(names.index(name), share) for name, share in WAIST_DETAILS.items()]
        self.fat = [(names.index(name), share) for name, share in FAT_DETAILS.items()]

    def solve(self, attributes, details, people, rounds=9):
        """Points (n, points, 3) after solving; also the values that were reached."""
        waist = np.zeros(len(details))
        slope, before = np.full(len(details), 0.7), None
        for _ in range(rounds):
            points, scale = self._points(attributes, details, waist, people)
            bodies = points[:, : self.vertex_count]
            raw_stature = people["stature"] / scale
            attributes["height"] = np.clip(attributes["height"] + 0.8 * (people["stature"] - raw_stature), 0.02, 0.98)
            mass = volumes(bodies, self.faces) * BODY_DENSITY
            if before is not None:  # secant estimate of d log(mass) / d weight
                step = attributes["weight"] - before[0]
                moved = np.abs(step) > 1e-3
                secant = (np.log(mass) - before[1])[moved] / step[moved]
                slope[moved] = np.clip(secant, 0.2, 1.5)
            before = attributes["weight"], np.log(mass)
            change = np.clip(np.log(people["mass"] / mass) / slope, -0.4, 0.4)
            attributes["weight"] = np.clip(attributes["weight"] + change, -0.05, 2.6)
            girth = np.array([self.tape.waist(body) for body in bodies])
            waist = np.clip(waist + 1.5 * (people["waist"] - girth) / people["waist"], -1.3, 1.8)
        points, _ = self._points(attributes, details, waist, people)
        return points

    def _points(self, attributes, details, waist, people):
        """Points scaled uniformly to the exact stature, and that scale."""
        changed = details.copy()
        for column, share in self.waist:
            changed[:, column] += share * waist
        fat = np.maximum(attributes["weight"] - FAT_STARTS_AT, 0)
        for column, share in self.fat:
            changed[:, column] += share * fat
        limited = attributes | {"weight": np.minimum(attributes["weight"], LARGEST_WEIGHT)}
        points = self.shapes.points(limited, changed)
        scale = people["stature"] / statures(points[:, : self.vertex_count])
        return points * scale[:, None, None], scale


def make_bodies(sex, count, maker: BodyMaker, random, *, spread=1.0, block=250) -> Bodies:
    """``spread`` widens the details (used for the held-out bodies)."""
    deviations = detail_deviations(maker.shapes.details)
    parts = []
    for start in range(0, count, block):
        size = min(block, count - start)
        people = draw_people(sex, size, random)
        attributes = draw_attributes(sex, people, random)
        details = np.clip(spread * deviations * random.standard_normal((size, len(deviations))), -1, 1)
        parts.append(maker.solve(attributes, details, people))
    points = np.concatenate(parts)
    return Bodies(
        points[:, : maker.vertex_count],
        points[:, maker.vertex_count :],
        np.full(count, SEXES.index(sex), dtype=np.uint8),
    )
