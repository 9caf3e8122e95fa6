"""Published figures the population is drawn from or held against.

NHANES 2017-2018: computed from the public-use body measures file of the CDC (public domain) for adults of 18 years and
over whose body mass index lies between 17 and 36: 2,239 women (80 % of the women examined) and 2,267 men (86 %). Every
examined person counts once; the sampling weights were not applied. The source targets do not reach heavier bodies
without distortion, so these are left out and stated as a limit.
ANSUR II: U.S. Army personnel 2012 (NATICK/TR-15/007), 4,082 men and 1,986 women, a fitter and younger population. Its
figures are quoted from memory to the nearest centimetre: a rough comparison, nothing is fitted to them.
Lengths in metres, mass in kilograms: (mean, standard deviation, 5th percentile, 95th percentile).
"""

import numpy as np

NHANES = {
    "female": {
        "stature": (1.5949, 0.0703, 1.483, 1.715),
        "mass": (69.05, 13.10, 49.1, 91.6),
        "waist": (0.9273, 0.1271, 0.720, 1.140),
    },
    "male": {
        "stature": (1.7314, 0.0767, 1.606, 1.857),
        "mass": (82.53, 15.10, 59.2, 108.1),
        "waist": (0.9812, 0.1277, 0.764, 1.182),
    },
}

ANSUR = {
    "female": {"chest": (0.95, 0.08), "waist": (0.86, 0.10), "hip": (1.02, 0.07), "thigh": (0.62, 0.06)},
    "male": {"chest": (1.06, 0.09), "waist": (0.94, 0.11), "hip": (1.02, 0.08), "thigh": (0.63, 0.06)},
}

# Age in years, stature in metres, log body mass index, log waist in metres: NHANES 2017-2018, all adults, with means
# shifted by a few hundredths at most so that what is left inside BODY_MASS_INDEX_RANGE meets the figures above.
JOINT_MEAN = {
    "female": np.array([49.5, 1.5920, 3.360, 4.5761 - np.log(100)]),
    "male": np.array([50.2, 1.7338, 3.366, 4.6453 - np.log(100)]),
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
BODY_MASS_INDEX_RANGE = (17.0, 36.0)


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
