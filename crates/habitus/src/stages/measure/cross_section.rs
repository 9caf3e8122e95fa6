//! Cuts of a part of the body with a plane, and the taut tape around them.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};

use crate::body::BodyModel;

/// A vertex belongs to the part when its bones carry at least this share of its skin weight.
const MEMBERSHIP: f64 = 0.5;

/// Limbs of a pair have about equal girths; a piece of less than this share of the longest is none.
const LIMB_SHARE: f64 = 0.4;

/// A plane through a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    /// A point in the plane.
    pub(super) origin: DVec3,
    /// Unit normal.
    pub(super) normal: DVec3,
}

/// The triangles that may belong to a part of the body, and how far each vertex belongs.
pub(super) struct BodyPart {
    faces: Vec<[u32; 3]>,
    membership: Vec<f64>,
}

/// One straight piece of a cut, between two edges of the mesh.
struct Segment {
    ends: [DVec3; 2],
    /// The mesh edge at each end; none where the part's border cut the segment short.
    edges: [Option<(u32, u32)>; 2],
}

/// A point of a cut: where it lies, how far it belongs to the part, and on which edge.
#[derive(Clone, Copy)]
struct Crossing {
    position: DVec3,
    membership: f64,
    edge: (u32, u32),
}

impl BodyPart {
    /// The part that follows some bones.
    pub(super) fn new(model: &BodyModel, bones: &[usize]) -> Self {
        let skin = model.surface().skin();
        let membership: Vec<f64> = (0..model.vertex_count())
            .map(|vertex| {
                skin.of(vertex).filter(|(bone, _)| bones.contains(bone)).map(|(_, weight)| weight).sum()
            })
            .collect();
        let belongs = |vertex: &u32| membership[*vertex as usize] >= MEMBERSHIP;
        let faces = model.faces().iter().filter(|face| face.iter().any(belongs)).copied().collect();
        Self { faces, membership }
    }

    /// All points of the cut, or those of the piece whose middle is nearest to `around`.
    pub(super) fn cut(&self, vertices: &[DVec3], plane: Plane, around: Option<DVec3>) -> Vec<DVec3> {
        let segments = self.segments(vertices, plane);
        match around {
            None => segments.iter().flat_map(|segment| segment.ends).collect(),
            Some(point) => nearest_piece(&segments, point),
        }
    }

    fn segments(&self, vertices: &[DVec3], plane: Plane) -> Vec<Segment> {
        let height = |vertex: u32| (vertices[vertex as usize] - plane.origin).dot(plane.normal);
        let mut segments = Vec::new();
        for face in &self.faces {
            let heights = face.map(height);
            let is_above = heights.map(|height| height >= 0.0);
            if is_above[0] == is_above[1] && is_above[1] == is_above[2] {
                continue;
            }
            let mut crossings = [0, 1, 2]
                .into_iter()
                .filter(|corner| is_above[*corner] != is_above[(corner + 1) % 3])
                .map(|corner| self.crossing(vertices, face, &heights, corner));
            if let (Some(first), Some(second)) = (crossings.next(), crossings.next()) {
                segments.extend(clip_to_part(first, second));
            }
        }
        segments
    }

    /// Where the edge that begins at a corner meets the plane, computed alike from both of its triangles.
    fn crossing(&self, vertices: &[DVec3], face: &[u32; 3], heights: &[f64; 3], corner: usize) -> Crossing {
        let next = (corner + 1) % 3;
        let (low, high) = if face[corner] < face[next] { (corner, next) } else { (next, corner) };
        let share = heights[low] / (heights[low] - heights[high]);
        let (a, b) = (face[low] as usize, face[high] as usize);
        Crossing {
            position: vertices[a].lerp(vertices[b], share),
            membership: self.membership[a] + (self.membership[b] - self.membership[a]) * share,
            edge: (face[low], face[high]),
        }
    }
}

/// The stretch of a segment that belongs to the part; membership is linear along it.
fn clip_to_part(first: Crossing, second: Crossing) -> Option<Segment> {
    let is_inside = [first.membership >= MEMBERSHIP, second.membership >= MEMBERSHIP];
    let border = || {
        let share = (MEMBERSHIP - first.membership) / (second.membership - first.membership);
        first.position.lerp(second.position, share)
    };
    match is_inside {
        [true, true] => Some(Segment {
            ends: [first.position, second.position],
            edges: [Some(first.edge), Some(second.edge)],
        }),
        [true, false] => Some(Segment { ends: [first.position, border()], edges: [Some(first.edge), None] }),
        [false, true] => {
            Some(Segment { ends: [border(), second.position], edges: [None, Some(second.edge)] })
        }
        [false, false] => None,
    }
}

/// Points of the connected piece whose middle (weighted by length) is nearest to a point; pieces much shorter than the
/// longest are folds of the skin, not limbs.
fn nearest_piece(segments: &[Segment], point: DVec3) -> Vec<DVec3> {
    let mut root: Vec<usize> = (0..segments.len()).collect();
    fn find(root: &mut [usize], mut index: usize) -> usize {
        while root[index] != index {
            root[index] = root[root[index]];
            index = root[index];
        }
        index
    }
    let mut owners: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    for (index, segment) in segments.iter().enumerate() {
        for edge in segment.edges.into_iter().flatten() {
            if let Some(other) = owners.insert(edge, index) {
                let (a, b) = (find(&mut root, index), find(&mut root, other));
                root[a.max(b)] = a.min(b);
            }
        }
    }
    let labels: Vec<usize> = (0..segments.len()).map(|index| find(&mut root, index)).collect();
    let mut middles: BTreeMap<usize, (DVec3, f64)> = BTreeMap::new();
    for (segment, label) in segments.iter().zip(&labels) {
        let [a, b] = segment.ends;
        let length = a.distance(b);
        let middle = middles.entry(*label).or_insert((DVec3::ZERO, 0.0));
        middle.0 += 0.5 * (a + b) * length;
        middle.1 += length;
    }
    let longest = middles.values().map(|(_, length)| *length).fold(0.0, f64::max);
    let nearest = middles
        .iter()
        .filter(|(_, (_, length))| *length > 0.0 && *length >= LIMB_SHARE * longest)
        .map(|(label, (sum, length))| (*label, (*sum / *length).distance_squared(point)))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(label, _)| label);
    segments
        .iter()
        .zip(&labels)
        .filter(|(_, label)| Some(**label) == nearest)
        .flat_map(|(segment, _)| segment.ends)
        .collect()
}

/// The taut tape around points of a plane: their convex outline, closed, or nothing if they enclose no area.
pub(super) fn taut_tape(points: &[DVec3], normal: DVec3) -> Option<Vec<DVec3>> {
    let (first_axis, second_axis) = normal.any_orthonormal_pair();
    let origin = *points.first()?;
    let mut flat: Vec<(DVec2, DVec3)> = points
        .iter()
        .map(|point| {
            let offset = *point - origin;
            (DVec2::new(offset.dot(first_axis), offset.dot(second_axis)), *point)
        })
        .collect();
    flat.sort_by(|(a, _), (b, _)| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    // Andrew's monotone chain: lower outline left to right, then upper outline back.
    let mut outline: Vec<(DVec2, DVec3)> = Vec::new();
    let mut add_outline = |points: &mut dyn Iterator<Item = &(DVec2, DVec3)>| {
        let start = outline.len();
        for point in points {
            while outline.len() >= start + 2 {
                let (a, b) = (outline[outline.len() - 2].0, outline[outline.len() - 1].0);
                if (b - a).perp_dot(point.0 - a) > 0.0 {
                    break;
                }
                outline.pop();
            }
            outline.push(*point);
        }
        outline.pop();
    };
    add_outline(&mut flat.iter());
    add_outline(&mut flat.iter().rev());
    if outline.len() < 3 {
        return None;
    }
    let mut tape: Vec<DVec3> = outline.iter().map(|(_, point)| *point).collect();
    tape.push(tape[0]);
    Some(tape)
}

/// Length of a polyline.
pub(super) fn polyline_length(points: &[DVec3]) -> f64 {
    points.windows(2).map(|pair| pair[0].distance(pair[1])).sum()
}
