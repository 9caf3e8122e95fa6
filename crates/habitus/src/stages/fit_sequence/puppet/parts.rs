//! The parts of the puppet: for each bone a piece of skin with a small linear space of its own, learnt from the bodies of
//! the model (P2 §4.2, after Zuffi and Black 2015, from the papers' text).

use glam::{DMat3, DVec3};
use habitus_geometry::farthest_points;
use nalgebra::{DMatrix, SymmetricEigen};

use crate::body::BodyModel;

/// Components of a part for differences between people.
pub(super) const SHAPE_COMPONENTS: usize = 4;
/// Components of a part for what bending the joints beside it does.
pub(super) const BEND_COMPONENTS: usize = 5;
/// All coefficients of a part, in standard deviations.
pub(super) const COEFFICIENTS: usize = SHAPE_COMPONENTS + BEND_COMPONENTS;

/// Vertices of a part that stitch it to a neighbour.
const INTERFACE_POINTS: usize = 8;
/// A bone that moves fewer vertices belongs to its parent's part.
const SMALLEST_PART: usize = 12;

/// Where a part is and what it looks like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct PartState {
    /// Posed from rest.
    pub rotation: DMat3,
    /// Position of the bone's joint in metres.
    pub joint: DVec3,
    /// First the shape's, then those of bending, in standard deviations.
    pub coefficients: [f64; COEFFICIENTS],
}

/// Which vertices a part has; positions in `vertices` are called slots.
#[derive(Clone, Debug)]
pub(super) struct PartLayout {
    /// The bone that carries it.
    pub bone: usize,
    /// The part it hangs on; the first part has none.
    pub parent: Option<usize>,
    /// Vertices of the model.
    pub vertices: Vec<u32>,
    /// The first of them are compared with the capture.
    pub data_count: usize,
    /// Slots shared with the parent, in the order of the parent's own `child_slots` for this part.
    pub parent_slots: Vec<usize>,
    /// The same points as slots of the parent.
    pub child_slots: Vec<usize>,
}

/// A part: its layout and its linear space, in the bone's own coordinates.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub layout: PartLayout,
    /// Mean of each vertex relative to the joint, in metres.
    pub mean: Vec<DVec3>,
    /// What bending does on average, contained in `mean`.
    pub bend_mean: Vec<DVec3>,
    /// Metres per standard deviation of each coefficient.
    pub basis: Vec<[DVec3; COEFFICIENTS]>,
    /// Outward normals of the data vertices.
    pub normals: Vec<DVec3>,
    /// Whether a data vertex is usually bare.
    pub is_bare: Vec<bool>,
    /// Shape coefficients of an identity: a row for each.
    pub shape_of_identity: DMatrix<f64>,
}

impl Part {
    /// Posed vertices in metres, slot by slot.
    pub fn points(&self, state: &PartState) -> Vec<DVec3> {
        self.mean
            .iter()
            .zip(&self.basis)
            .map(|(mean, basis)| state.joint + state.rotation * local(*mean, basis, &state.coefficients))
            .collect()
    }

    /// Vertices in the bone's own coordinates.
    pub fn local_points(&self, coefficients: &[f64; COEFFICIENTS]) -> Vec<DVec3> {
        self.mean.iter().zip(&self.basis).map(|(mean, basis)| local(*mean, basis, coefficients)).collect()
    }
}

fn local(mean: DVec3, basis: &[DVec3; COEFFICIENTS], coefficients: &[f64; COEFFICIENTS]) -> DVec3 {
    basis.iter().zip(coefficients).fold(mean, |sum, (direction, value)| sum + *direction * *value)
}

/// Cuts the model into parts: the vertices that each bone moves most, stitched along the faces between them.
pub(super) fn layouts(model: &BodyModel, points_per_part: usize) -> Vec<PartLayout> {
    let bones = model.skeleton().bones();
    let dominant = model.dominant_bones();
    let mut counts = vec![0_usize; bones.len()];
    dominant.iter().for_each(|bone| counts[*bone] += 1);
    // Parents come before their children, so that a small bone's parent already knows its part.
    let mut part_of_bone = vec![0; bones.len()];
    let mut layouts: Vec<PartLayout> = Vec::new();
    for (bone, found) in bones.iter().enumerate() {
        let parent = found.parent.map(|parent| part_of_bone[parent]);
        part_of_bone[bone] = match parent {
            Some(parent) if counts[bone] < SMALLEST_PART => parent,
            _ => layouts.len(),
        };
        if part_of_bone[bone] == layouts.len() {
            layouts.push(PartLayout {
                bone,
                parent,
                vertices: Vec::new(),
                data_count: 0,
                parent_slots: Vec::new(),
                child_slots: Vec::new(),
            });
        }
    }
    let part_of: Vec<usize> = dominant.iter().map(|bone| part_of_bone[*bone]).collect();
    let mean = model.mean_vertices();
    for (part, layout) in layouts.iter_mut().enumerate() {
        let own: Vec<u32> = (0..mean.len() as u32).filter(|v| part_of[*v as usize] == part).collect();
        layout.vertices = spread_over(mean, &own, points_per_part);
        layout.data_count = layout.vertices.len();
        let landmarks = model.landmark_vertices().iter().filter(|v| part_of[**v as usize] == part);
        layout.vertices.extend(landmarks);
    }
    for part in 1..layouts.len() {
        let parent = layouts[part].parent.unwrap_or(0);
        let seam = seam_vertices(model, &part_of, part, parent);
        for vertex in spread_over(mean, &seam, INTERFACE_POINTS) {
            layouts[part].vertices.push(vertex);
            let slot = layouts[part].vertices.len() - 1;
            layouts[part].parent_slots.push(slot);
            layouts[parent].vertices.push(vertex);
            let slot = layouts[parent].vertices.len() - 1;
            layouts[part].child_slots.push(slot);
        }
    }
    layouts
}

fn spread_over(positions: &[DVec3], vertices: &[u32], count: usize) -> Vec<u32> {
    let points: Vec<DVec3> = vertices.iter().map(|vertex| positions[*vertex as usize]).collect();
    farthest_points(&points, count).into_iter().map(|picked| vertices[picked as usize]).collect()
}

/// Vertices of the faces that lie across the border of two parts; where they do not touch, those around the joint.
fn seam_vertices(model: &BodyModel, part_of: &[usize], part: usize, parent: usize) -> Vec<u32> {
    let of = |vertex: u32| part_of[vertex as usize];
    let mut seam: Vec<u32> = model
        .faces()
        .iter()
        .filter(|face| {
            face.iter().any(|v| of(*v) == part)
                && face.iter().any(|v| of(*v) == parent)
                && face.iter().all(|v| of(*v) == part || of(*v) == parent)
        })
        .flatten()
        .copied()
        .collect();
    seam.sort_unstable();
    seam.dedup();
    if seam.len() >= 3 {
        return seam;
    }
    let mean = model.mean_vertices();
    let bone_joints = model.surface().joint_map();
    let middle = bone_joints.mean[part.min(bone_joints.mean.len() - 1)];
    let mut both: Vec<u32> = (0..mean.len() as u32).filter(|v| of(*v) == part || of(*v) == parent).collect();
    both.sort_by(|a, b| {
        let distance = |v: u32| mean[v as usize].distance_squared(middle);
        distance(*a).total_cmp(&distance(*b))
    });
    both.truncate(2 * INTERFACE_POINTS);
    both
}

/// Leading principal components of centred columns: directions times their standard deviation, and the coefficients
/// (rows) that each column has along them. The columns' sum of squares is the variance.
pub(super) struct Components {
    pub directions: Vec<Vec<f64>>,
    pub deviations: Vec<f64>,
    /// A unit row over the columns for each component.
    pub rows: DMatrix<f64>,
}

/// Components of `columns` by the eigenvectors of its Gram matrix.
pub(super) fn leading_components(columns: &DMatrix<f64>, count: usize) -> Components {
    let eigen = SymmetricEigen::new(columns.tr_mul(columns));
    let mut order: Vec<usize> = (0..columns.ncols()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let mut found = Components {
        directions: Vec::with_capacity(count),
        deviations: Vec::with_capacity(count),
        rows: DMatrix::zeros(count, columns.ncols()),
    };
    for component in 0..count {
        let place = order.get(component).copied().filter(|k| eigen.eigenvalues[*k] > 1e-14);
        let Some(place) = place else {
            found.directions.push(vec![0.0; columns.nrows()]);
            found.deviations.push(0.0);
            continue;
        };
        let mut row = eigen.eigenvectors.column(place).into_owned();
        let largest = row.iter().fold(0.0_f64, |best, x| if x.abs() > best.abs() { *x } else { best });
        if largest < 0.0 {
            row.neg_mut();
        }
        found.directions.push((columns * &row).as_slice().to_vec());
        found.deviations.push(eigen.eigenvalues[place].max(0.0).sqrt());
        found.rows.row_mut(component).copy_from(&row.transpose());
    }
    found
}
