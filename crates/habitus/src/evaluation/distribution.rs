//! Many distances as counts, so that the percentiles of millions of them need no memory.

/// Width of a bin, mm: the resolution of percentiles.
const BIN_MM: f64 = 0.1;
/// Bins; the last one also holds everything above.
const BINS: usize = 20_000;

/// Counts of distances in mm.
#[derive(Clone, Debug, PartialEq)]
pub struct Distribution {
    counts: Vec<u64>,
    sum: f64,
    count: u64,
}

impl Default for Distribution {
    fn default() -> Self {
        Self { counts: vec![0; BINS], sum: 0.0, count: 0 }
    }
}

impl Distribution {
    /// Counts more distances, mm.
    pub fn extend(&mut self, distances_mm: &[f64]) {
        for distance in distances_mm {
            // Casts saturate: what lies above the last bin is counted in it.
            self.counts[((distance / BIN_MM) as usize).min(BINS - 1)] += 1;
            self.sum += distance;
        }
        self.count += distances_mm.len() as u64;
    }

    /// Counts what another distribution has counted.
    pub fn merge(&mut self, other: &Self) {
        self.counts.iter_mut().zip(&other.counts).for_each(|(own, other)| *own += other);
        self.sum += other.sum;
        self.count += other.count;
    }

    /// The mean, mm; zero of none.
    pub fn mean(&self) -> f64 {
        self.sum / self.count.max(1) as f64
    }

    /// The distance that this share lies below, mm, to a tenth of a millimetre; zero of none.
    pub fn percentile(&self, share: f64) -> f64 {
        let wanted = share * self.count as f64;
        let mut below = 0;
        for (bin, count) in self.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            if (below + count) as f64 >= wanted {
                let part = (wanted - below as f64) / *count as f64;
                return (bin as f64 + part.clamp(0.0, 1.0)) * BIN_MM;
            }
            below += count;
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::Distribution;

    #[test]
    fn percentiles_and_mean_are_those_of_the_numbers() {
        let mut distribution = Distribution::default();
        let numbers: Vec<f64> = (0..1000).map(|k| f64::from(k) * 0.05 + 0.02).collect();
        distribution.extend(&numbers[..400]);
        let mut others = Distribution::default();
        others.extend(&numbers[400..]);
        distribution.merge(&others);
        assert!((distribution.mean() - 24.995).abs() < 1e-9);
        for share in [0.05, 0.5, 0.95] {
            assert!((distribution.percentile(share) - 50.0 * share).abs() <= 0.11, "{share}");
        }
    }

    #[test]
    fn what_is_far_above_all_bins_still_counts() {
        let mut distribution = Distribution::default();
        distribution.extend(&[1.0, 1e9]);
        assert!(distribution.percentile(0.99) > 1900.0);
        assert_eq!(Distribution::default().percentile(0.5), 0.0);
    }
}
