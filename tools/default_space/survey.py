"""Published figures the population is drawn from or held against.

NHANES 2017–2018: computed from the public-use body measures file (CDC, public domain), adults of 18 years and over,
every examined person counted once (the sampling weights were not applied).
ANSUR II: U.S. Army personnel 2012 (NATICK/TR-15/007), 4,082 men and 1,986 women, a fitter and younger population; its
figures are quoted from memory to the nearest centimetre and serve as a rough comparison only.
Lengths in metres, mass in kilograms: (mean, standard deviation, 5th percentile, 95th percentile).
"""

import numpy as np

NHANES = {
    "female": {
        "stature": (1.5971, 0.0702, 1.483, 1.716),
        "mass": (77.07, 22.40, 49.4, 120.2),
        "waist": (0.9836, 0.1756, 0.724, 1.290),
    },
    "male": {
        "stature": (1.7348, 0.0767, 1.608, 1.861),
        "mass": (88.24, 22.17, 59.3, 129.3),
        "waist": (1.0204, 0.1665, 0.766, 1.322),
    },
}

ANSUR = {
    "female": {"chest": (0.95, 0.08), "waist": (0.86, 0.10), "hip": (1.02, 0.07), "thigh": (0.62, 0.06)},
    "male": {"chest": (1.06, 0.09), "waist": (0.94, 0.11), "hip": (1.02, 0.08), "thigh": (0.63, 0.06)},
}

# Age in years, stature in metres, log body mass index, log waist in metres (NHANES 2017–2018, adults).
JOINT_MEAN = {
    "female": np.array([49.5, 1.5971, 3.369, 4.5731 - np.log(100)]),
    "male": np.array([50.2, 1.7348, 3.349, 4.6123 - np.log(100)]),
}
JOINT_DEVIATION = {
    "female": np.array([18.2, 0.0704, 0.250, 0.1765]),
    "male": np.array([18.7, 0.0768, 0.210, 0.1622]),
}
JOINT_CORRELATION = {
    "female": np.array(
        [[1.0, -0.23, 0.06, 0.20], [-0.23, 1.0, 0.01, 0.11], [0.06, 0.01, 1.0, 0.92], [0.20, 0.11, 0.92, 1.0]]
    ),
    "male": np.array(
        [[1.0, -0.18, 0.04, 0.25], [-0.18, 1.0, 0.09, 0.19], [0.04, 0.09, 1.0, 0.93], [0.25, 0.19, 0.93, 1.0]]
    ),
}
AGE_RANGE = (18.0, 80.0)
BODY_MASS_INDEX_RANGE = (17.0, 46.0)


def draw_people(sex: str, count: int, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Age, stature, mass and waist of ``count`` adults of one sex."""
    deviation = JOINT_DEVIATION[sex]
    covariance = JOINT_CORRELATION[sex] * np.outer(deviation, deviation)
    kept = np.zeros((0, 4))
    while len(kept) < count:
        drawn = random.multivariate_normal(JOINT_MEAN[sex], covariance, size=4 * count)
        index = np.exp(drawn[:, 2])
        likely = (np.abs(drawn - JOINT_MEAN[sex]) < 2.8 * deviation)[:, 1:].all(1)
        likely &= (drawn[:, 0] >= AGE_RANGE[0]) & (drawn[:, 0] <= AGE_RANGE[1])
        likely &= (index >= BODY_MASS_INDEX_RANGE[0]) & (index <= BODY_MASS_INDEX_RANGE[1])
        kept = np.concatenate([kept, drawn[likely]])
    kept = kept[:count]
    return {
        "age": kept[:, 0],
        "stature": kept[:, 1],
        "mass": np.exp(kept[:, 2]) * kept[:, 1] ** 2,
        "waist": np.exp(kept[:, 3]),
    }
