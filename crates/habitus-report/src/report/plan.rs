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
    let fixed = fixed_size(model.body.joints.len(), model.body.rest_vertices.len());
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

/// Frames that a page can show at most, evenly chosen: it need not keep the captures of others.
pub(crate) fn view_frames(
    frame_count: usize,
    bone_count: usize,
    vertex_count: usize,
    options: &ReportOptions,
) -> Vec<usize> {
    let capture_vertices = options.capture_vertex_floor.min(options.capture_vertex_limit);
    let least =
        fixed_size(bone_count, vertex_count) + base64_size(capture_vertices * BYTES_PER_CAPTURE_VERTEX);
    even_selection(frame_count, (options.size_limit / least).clamp(frame_count.min(1), frame_count))
}

/// Bytes of page for a frame without its capture.
fn fixed_size(bone_count: usize, vertex_count: usize) -> usize {
    base64_size(bone_count * 48 + vertex_count) + FRAME_OVERHEAD
}

/// Bytes of base64 text for bytes of data.
pub(crate) fn base64_size(bytes: usize) -> usize {
    bytes.div_ceil(3) * 4
}

/// `count` numbers below `total`, evenly spread, with the first and the last.
fn even_selection(total: usize, count: usize) -> Vec<usize> {
    if count <= 1 {
        return vec![0; count];
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
