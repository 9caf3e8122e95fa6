"""How the source's macro targets combine, and which detail targets a body may use.

A macro target's weight is the product of hat functions over the attributes in its file name (``macro.json`` of the
source states which). Attributes run from 0 to 1; the middle value of muscle, weight, cup and firmness has targets of
its own, the middle of height and proportions is the absence of a target.
"""

from dataclasses import dataclass

import numpy as np

from source import Source

SEXES = ("female", "male")
RACES = ("african", "asian", "caucasian")
THREE_STEPS = {
    "muscle": ("minmuscle", "averagemuscle", "maxmuscle"),
    "weight": ("minweight", "averageweight", "maxweight"),
    "cup": ("mincup", "averagecup", "maxcup"),
    "firmness": ("minfirmness", "averagefirmness", "maxfirmness"),
    "height": ("minheight", None, "maxheight"),
    "proportions": ("uncommonproportions", None, "idealproportions"),
}
OPPOSITES = (
    ("decr", "incr"),
    ("down", "up"),
    ("backward", "forward"),
    ("in", "out"),
    ("compress", "uncompress"),
    ("concave", "convex"),
    ("l", "r"),  # asymmetric targets, one for each side
)


def hats(value: np.ndarray) -> np.ndarray:
    """(3, n) weights of the low, middle and high target of attributes in 0…1 (extrapolates a little beyond)."""
    low = np.maximum(1 - 2 * value, 0)
    high = np.maximum(2 * value - 1, 0)
    return np.stack([low, 1 - low - high, high])


@dataclass
class Detail:
    """A signed detail: ``negative`` targets at −1, ``positive`` targets at +1 (left and right together)."""

    name: str
    negative: tuple[str, ...]
    positive: tuple[str, ...]


class ShapeTargets:
    """All targets that act on a chosen set of points, as one dense matrix."""

    def __init__(self, source: Source, points_from_source, details: list[Detail]):
        self.base = points_from_source @ source.positions
        self.details = details
        self._source = source
        self._points_from_source = points_from_source.tocsc()
        self._rows, self._row_of = [], {}
        self.macros = list(self._macro_names())
        for name, _ in self.macros:
            self._row(name)
        for detail in details:
            for name in detail.negative + detail.positive:
                self._row(name)
        self.offsets = np.stack(self._rows).astype(np.float32)
        del self._rows

    def _row(self, name):
        if name not in self._row_of:
            indices, offsets = self._source.target(name)
            moved = self._points_from_source[:, indices] @ offsets
            self._row_of[name] = len(self._rows)
            self._rows.append(np.asarray(moved).ravel())

    def _macro_names(self):
        """Pairs of target name and the attributes whose product is its weight."""
        for s, sex in enumerate(SEXES):
            for a, age in enumerate(("young", "old")):
                for r, race in enumerate(RACES):
                    yield f"macrodetails/{race}-{sex}-{age}", {"sex": s, "age": a, "race": r}
                for m, muscle in enumerate(THREE_STEPS["muscle"]):
                    for w, weight in enumerate(THREE_STEPS["weight"]):
                        keys = {"sex": s, "age": a, "muscle": m, "weight": w}
                        stem = f"{sex}-{age}-{muscle}-{weight}"
                        yield f"macrodetails/universal-{stem}", keys
                        for attribute in ("height", "proportions"):
                            for step in (0, 2):
                                name = f"macrodetails/{attribute}/{stem}-{THREE_STEPS[attribute][step]}"
                                yield name, keys | {attribute: step}
                        if sex == "female":
                            yield from self._breast_names(stem, keys)

    def _breast_names(self, stem, keys):
        for c, cup in enumerate(THREE_STEPS["cup"]):
            for f, firmness in enumerate(THREE_STEPS["firmness"]):
                name = f"breast/{stem}-{cup}-{firmness}"
                if self._source.has_target(name):
                    yield name, keys | {"cup": c, "firmness": f}

    def weights(self, attributes: dict[str, np.ndarray], details: np.ndarray) -> np.ndarray:
        """(n, targets) weights; ``attributes`` hold arrays of n values, ``details`` is (n, number of details)."""
        count = len(attributes["sex"])
        tables = {name: hats(attributes[name]) for name in THREE_STEPS}
        tables["sex"] = np.stack([1 - attributes["sex"], attributes["sex"]])
        tables["age"] = np.stack([1 - attributes["age"], attributes["age"]])
        tables["race"] = attributes["race"].T
        result = np.zeros((count, len(self.offsets)), dtype=np.float32)
        for name, keys in self.macros:
            product = np.ones(count)
            for key, step in keys.items():
                product = product * tables[key][step]
            result[:, self._row_of[name]] += product
        for index, detail in enumerate(self.details):
            for name in detail.positive:
                result[:, self._row_of[name]] += np.maximum(details[:, index], 0)
            for name in detail.negative:
                result[:, self._row_of[name]] += np.maximum(-details[:, index], 0)
        return result

    def points(self, attributes, details) -> np.ndarray:
        """(n, points, 3) positions in metres, before any uniform scaling."""
        moved = self.weights(attributes, details) @ self.offsets
        return moved.reshape(len(moved), -1, 3) + self.base.astype(np.float32)


def signed_details(source: Source, folder: str, leave_out: tuple[str, ...] = ()) -> list[Detail]:
    """All symmetric signed details of a target folder; left and right targets are always used together."""
    names = {path.name.removesuffix(".target.gz") for path in (source.folder / "targets" / folder).glob("*.target.gz")}
    details = []
    for name in sorted(names):
        for low, high in OPPOSITES:
            if not name.endswith("-" + high) or name.startswith("r-"):
                continue
            stem = name.removesuffix("-" + high)
            if f"{stem}-{low}" not in names or any(word in stem for word in leave_out):
                continue
            stems = [stem, "r-" + stem[2:]] if stem.startswith("l-") else [stem]
            details.append(
                Detail(
                    f"{folder}/{stem.removeprefix('l-')}",
                    tuple(f"{folder}/{s}-{low}" for s in stems),
                    tuple(f"{folder}/{s}-{high}" for s in stems),
                )
            )
    return details
