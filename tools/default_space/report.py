"""Pictures and tables of the finished space for the book."""

import numpy as np

import checks
import render
import rig
from geometry import self_intersections
from measure import BODY_DENSITY, statures, volumes
from posing import bone_transforms, skin
from survey import ANSUR, NHANES


class Gallery:
    """Renders bodies of one model."""

    def __init__(self, model, axes):
        self.mean = model["mean"].astype(float)
        self.basis = model["basis"].astype(float)
        self.deviations = model["standard_deviations"].astype(float)
        self.faces, self.axes = model["faces"], axes
        self.bones, self.weights = model["skin_bones"], model["skin_weights"].astype(float)
        regressor = tuple(model[f"joint_regressor_{part}"] for part in ("offsets", "vertices", "values"))
        self.matrix = rig.regressor_matrix(regressor, len(self.mean))

    def rest(self, coefficients):
        count = len(coefficients)
        return self.mean + np.tensordot(coefficients * self.deviations[:count], self.basis[:count], 1)

    def posed(self, angles):
        """The mean body with some angles (degrees, by axis name)."""
        values = np.zeros(len(self.axes))
        for name, angle in angles.items():
            values[[axis.name for axis in self.axes].index(name)] = np.radians(angle)
        joints = self.matrix @ self.mean
        rotations, translations = bone_transforms(joints, self.axes, values)
        posed_joints = np.einsum("bij,bj->bi", rotations, joints) + translations
        return skin(self.mean, rotations, translations, self.bones, self.weights), posed_joints

    def shot(self, vertices, *, yaw=25.0, centre=(0, 0.86, 0), span=2.1, size=(170, 290), **more):
        return render.picture(vertices, self.faces, yaw=yaw, centre=np.array(centre), span=span, size=size, **more)


def write_pictures(gallery: Gallery, held, folder, random):
    def save(name, rows):
        render.save(folder / f"default_space_{name}.png", render.sheet(rows), colours=48)

    half = gallery.shot(gallery.mean, span=1.85, size=(330, 560), yaw=0, wire=True)
    side = gallery.shot(gallery.mean, span=1.85, size=(330, 560), yaw=90)
    back = gallery.shot(gallery.mean, span=1.85, size=(330, 560), yaw=180, wire=True)
    save("mean", [[half, side, back]])
    face = gallery.mean[gallery.mean[:, 1] > gallery.mean[:, 1].max() - 0.25].mean(0)
    joints = gallery.matrix @ gallery.mean
    hand, foot = joints[rig.BONES.index("left_hand")] + [0.03, -0.08, 0.06], joints[rig.BONES.index("left_foot")]
    close = [
        gallery.shot(gallery.mean, centre=face, span=0.34, size=(330, 330), yaw=30, wire=True),
        gallery.shot(gallery.mean, centre=hand, span=0.26, size=(330, 330), yaw=75, wire=True),
        gallery.shot(
            gallery.mean, centre=foot + [0, -0.02, 0.06], span=0.32, size=(330, 330), yaw=40, pitch=-30, wire=True
        ),
    ]
    save("details", [close])
    save(
        "components",
        [[gallery.shot(gallery.rest(sign * 3 * np.eye(5)[k])) for k in range(5)] for sign in (-1, 1)],
    )
    people = checks.random_identities(8, len(gallery.basis), random)
    save("random", [[gallery.shot(gallery.rest(row)) for row in people]])
    save("held_out", [[gallery.shot(body) for body in held[[0, 3, 6, 12, 15, 18]]]])
    save("bending", bending_rows(gallery))


def bending_rows(gallery):
    """Elbow, knee, hip and shoulder of the mean body at 0, 30, 60, 90 and 120 degrees."""
    views = (
        ("left_elbow_flexion", "left_forearm", 70, 0.55),
        ("left_knee_flexion", "left_shank", 90, 0.75),
        ("left_hip_flexion", "left_thigh", 90, 1.0),
        ("left_shoulder_elevation", "left_upper_arm", 0, 0.95),
        ("left_shoulder_elevation", "left_upper_arm", 160, 0.95),
    )
    rows = []
    for axis, bone, yaw, span in views:
        row = []
        for angle in (0, 30, 60, 90, 120):
            body, joints = gallery.posed({axis: angle})
            centre = joints[rig.BONES.index(bone)]
            row.append(gallery.shot(body, yaw=yaw, centre=centre, span=span, size=(220, 220)))
        rows.append(row)
    return rows


def marginals(built):
    """Rows (sex, measure, values) over the training bodies, in their source pose."""
    faces = built.template.faces
    for sex, part in zip(("female", "male"), built.train):
        girths = [built.tape.girths(body) for body in part.vertices]
        yield sex, "stature", statures(part.vertices)
        yield sex, "mass", volumes(part.vertices.astype(float), faces) * BODY_DENSITY
        for name in girths[0]:
            yield sex, name, np.array([girth[name] for girth in girths])


def spread_text(values, factor):
    """Mean ± deviation (5th, 95th percentile)."""
    mean, deviation, low, high = (f"{factor * value:.1f}" for value in values)
    return f"{mean} ± {deviation} ({low}, {high})"


def marginal_table(built):
    lines = [
        "| sex | measure | this population: mean ± sd (p5, p95) | NHANES 2017–2018 | ANSUR II 2012, recalled |",
        "| --- | --- | --- | --- | --- |",
    ]
    for sex, name, values in marginals(built):
        unit, factor = ("kg", 1) if name == "mass" else ("cm", 100)
        own = spread_text((values.mean(), values.std(), *np.percentile(values, [5, 95])), factor)
        survey = NHANES[sex].get(name)
        nhanes = spread_text(survey, factor) if survey else "–"
        rough = ANSUR[sex].get(name)
        ansur = f"≈ {100 * rough[0]:.0f} ± {100 * rough[1]:.0f}" if rough else "–"
        lines.append(f"| {sex} | {name}, {unit} | {own} | {nhanes} | {ansur} |")
    return lines


def reconstruction_table(model, bodies, held):
    mean, basis = model["mean"].astype(float), model["basis"].astype(float)
    deviations = model["standard_deviations"].astype(float)
    lines = [
        "| components | held-out: mean | p95 | worst body's mean | training: mean | variance explained |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    out = checks.reconstruction_errors(held, mean, basis, deviations)
    own = checks.reconstruction_errors(bodies, mean, basis, deviations)
    total = ((bodies - bodies.mean(0)) ** 2).sum() / (len(bodies) - 1)
    for count in out:
        share = (deviations[:count] ** 2).sum() / total
        a, b, c = out[count]
        lines.append(
            f"| {count} | {a:.2f} mm | {b:.2f} mm | {c:.2f} mm | {own[count][0]:.2f} mm | {100 * share:.2f} % |"
        )
    return lines


def check_lines(gallery, random, count=300):
    pairs = checks.edge_pairs(gallery.faces)
    bodies = [gallery.rest(row) for row in checks.random_identities(count, len(gallery.basis), random)]
    reports = [checks.face_report(body, gallery.faces, pairs) for body in bodies]
    worst, poor, folds = (np.array(column) for column in zip(*reports))
    mean_crossings = len(self_intersections(gallery.mean, gallery.faces))
    crossings = [len(self_intersections(body, gallery.faces)) for body in bodies[:12]]
    mean_folds = checks.face_report(gallery.mean, gallery.faces, pairs)[2]
    edges = np.linalg.norm(gallery.mean[gallery.faces] - gallery.mean[np.roll(gallery.faces, -1, 1)], axis=2).ravel()
    return [
        f"- {len(gallery.mean):,} vertices, {len(gallery.faces):,} faces; edge length p5 / median / p95 "
        + " / ".join(f"{1000 * value:.1f}" for value in np.percentile(edges, [5, 50, 95]))
        + " mm.",
        f"- {count} random bodies (every coefficient drawn from N(0, 1), clipped at ±3): smallest face quality "
        f"{worst.min():.3f} (1 = equilateral), {100 * poor.mean():.2f} % of faces below 0.1, "
        f"{folds.mean():.1f} folded edges a body (mean body: {mean_folds}).",
        f"- pairs of faces that pass through each other: {mean_crossings} in the mean body, "
        f"{np.mean(crossings):.1f} on average in 12 random bodies.",
    ]


def write_tables(path, sections):
    text = ["<!-- Written by tools/default_space/make.py; do not edit. -->", ""]
    for title, lines in sections:
        text += [f"### {title}", "", *lines, ""]
    path.write_text("\n".join(text))
