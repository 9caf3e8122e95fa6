//! How many frames and how much of each capture fit into the page.

use super::{ModelView, ReportOptions};

/// Bytes of JSON and markup around a frame's block.
const FRAME_OVERHEAD: usize = 1_800;
/// A closed mesh has about two faces a vertex: 6 bytes of position and 2 × 6 bytes of face.
const BYTES_PER_CAPTURE_VERTEX: usize = 18;

/// What goes into the 3D view.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Plan {
    /// Which of the model's frames, ascending.
    pub(crate) selected: Vec<usize>,
    /// Largest number of vertices of a capture.
    pub(crate) capture_vertices: usize,
}

/// The plan for this many bytes of page; nothing is selected when not even one frame fits.
pub(crate) fn plan(model: &ModelView, available: usize, options: &ReportOptions) -> Plan {
    let frame_count = model.frames.len();
    let fixed = base64_size(model.body.joints.len() * 48 + model.body.rest_vertices.len()) + FRAME_OVERHEAD;
    let largest = model.frames.iter().map(|view| view.capture.positions.len()).max().unwrap_or(0);
    let wanted = largest.min(options.capture_vertex_limit);
    let floor = wanted.min(options.capture_vertex_floor);
    let at_floor = fixed + base64_size(floor * BYTES_PER_CAPTURE_VERTEX);
    let count = (available / at_floor).min(frame_count);
    if count == 0 {
        return Plan { selected: Vec::new(), capture_vertices: 0 };
    }
    let room = (available / count).saturating_sub(fixed);
    let capture_vertices = (room / 4 * 3 / BYTES_PER_CAPTURE_VERTEX).clamp(floor, wanted);
    Plan { selected: even_selection(frame_count, count), capture_vertices }
}

/// Bytes of base64 text for bytes of data.
pub(crate) fn base64_size(bytes: usize) -> usize {
    bytes.div_ceil(3) * 4
}

/// `count` numbers below `total`, evenly spread, with the first and the last.
fn even_selection(total: usize, count: usize) -> Vec<usize> {
    if count == 1 {
        return vec![0];
    }
    (0..count).map(|i| (i * (total - 1) + (count - 1) / 2) / (count - 1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn selections_are_even_and_keep_both_ends() {
        for (total, count) in [(100, 7), (8, 8), (9, 2), (1000, 333)] {
            let selected = even_selection(total, count);
            assert_eq!(selected.len(), count);
            assert_eq!((selected[0], selected[count - 1]), (0, total - 1));
            let steps: Vec<usize> = selected.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let [low, high] = [steps.iter().min(), steps.iter().max()].map(|step| *step.expect("steps"));
            assert!(high - low <= 1 && low >= 1, "{total} {count}: {selected:?}");
        }
    }
}
