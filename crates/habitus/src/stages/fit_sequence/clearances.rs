//! What the frames of a sequence say of the gap between skin and cloth.
//!
//! Cloth that moves on the body stands off it: in made-up sequences a covered vertex's smallest clearance grows with the
//! deviation of its clearance over the frames (medians at 2 to 6 mm of deviation: 3 to 5 mm in a tight suit, 2 to 8 in a
//! wide dress, 5 to 13 under layers), until hems swing against the skin. So a part of the gap that must be expected where
//! cloth comes closest can be read off its movement, without knowing the garment.

use super::config::RefineConfig;

/// Clearances beyond this, metres, are of another limb or of a wide hem, and say nothing of how cloth lies here.
const FARTHEST: f64 = 0.08;
/// Frames that a deviation needs.
const FEWEST_FRAMES: f64 = 4.0;

/// Gathered clearances of each vertex over some frames, metres.
pub(super) struct Clearances {
    /// The smallest; infinite where no frame saw the vertex.
    pub smallest: Vec<f64>,
    /// Count, sum and sum of squares of those that say how the cloth lies.
    moments: Vec<[f64; 3]>,
}

impl Clearances {
    pub(super) fn new(vertex_count: usize) -> Self {
        Self { smallest: vec![f64::INFINITY; vertex_count], moments: vec![[0.0; 3]; vertex_count] }
    }

    /// Adds one frame; infinite where the frame did not see a vertex.
    pub(super) fn add(&mut self, clearances: &[f64]) {
        for ((smallest, moments), clearance) in
            self.smallest.iter_mut().zip(&mut self.moments).zip(clearances)
        {
            *smallest = smallest.min(*clearance);
            if clearance.abs() < FARTHEST {
                for (moment, power) in moments.iter_mut().zip([1.0, *clearance, clearance * clearance]) {
                    *moment += power;
                }
            }
        }
    }

    /// The gap, metres, that is expected between a covered vertex and the cloth where it comes closest.
    pub(super) fn expected_gap(&self, vertex: usize, config: &RefineConfig) -> f64 {
        let [count, sum, squares] = self.moments[vertex];
        if count < FEWEST_FRAMES {
            return 0.0;
        }
        let mean = sum / count;
        let deviation = (squares / count - mean * mean).max(0.0).sqrt();
        (config.gap_per_deviation * deviation).min(config.largest_gap)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gap(clearances: &[f64]) -> f64 {
        let mut gathered = Clearances::new(1);
        clearances.iter().for_each(|clearance| gathered.add(&[*clearance]));
        gathered.expected_gap(0, &RefineConfig::default())
    }

    #[test]
    fn the_expected_gap_follows_the_movement_of_the_cloth() {
        let config = RefineConfig::default();
        let tight = gap(&[0.003, 0.004, 0.003, 0.004]);
        assert!((tight - config.gap_per_deviation * 0.0005).abs() < 1e-12, "{tight}");
        // Where the cloth lies changes nothing, only how it moves.
        assert!((tight - gap(&[0.023, 0.024, 0.023, 0.024])).abs() < 1e-12);
        assert_eq!(gap(&[0.0, 0.07, 0.0, 0.07]), config.largest_gap);
    }

    #[test]
    fn too_few_frames_and_far_cloth_say_nothing() {
        assert_eq!(gap(&[0.0, 0.02, 0.01]), 0.0);
        assert_eq!(gap(&[0.0, 0.02, f64::INFINITY, 0.3, 0.01]), 0.0);
    }
}
