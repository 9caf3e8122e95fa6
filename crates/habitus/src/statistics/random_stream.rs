//! A small reproducible source of random numbers, seeded by a number and the name of what it is for.

/// SplitMix64 (Steele, Lea and Flood 2014): the same numbers on every machine and thread.
#[derive(Clone, Debug)]
pub struct RandomStream {
    state: u64,
}

impl RandomStream {
    /// A stream of its own for each item, so that adding an item never changes another's draws.
    pub fn named(seed: u64, name: &str) -> Self {
        let fnv = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
        let mut stream = Self { state: fnv ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) };
        stream.next();
        stream
    }

    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.state;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^ (bits >> 31)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A whole number below `limit`, which must not be zero.
    pub fn below(&mut self, limit: usize) -> usize {
        ((self.unit() * limit as f64) as usize).min(limit - 1)
    }

    /// Standard normal (Box–Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }

    /// `count` different whole numbers below `limit` (all of them if there are fewer), in a random order.
    pub fn choose(&mut self, count: usize, limit: usize) -> Vec<usize> {
        let mut numbers: Vec<usize> = (0..limit).collect();
        let count = count.min(limit);
        for place in 0..count {
            let other = place + self.below(limit - place);
            numbers.swap(place, other);
        }
        numbers.truncate(count);
        numbers
    }
}

#[cfg(test)]
mod tests {
    use super::RandomStream;

    #[test]
    fn normal_draws_have_zero_mean_and_unit_variance() {
        let mut stream = RandomStream::named(1, "moments");
        let draws: Vec<f64> = (0..40_000).map(|_| stream.normal()).collect();
        let mean = draws.iter().sum::<f64>() / draws.len() as f64;
        let variance = draws.iter().map(|draw| (draw - mean).powi(2)).sum::<f64>() / draws.len() as f64;
        // Four standard errors of the mean (1/200) and of the variance (√2/200).
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
    }

    #[test]
    fn streams_with_different_names_or_seeds_differ() {
        let first = |seed, name| RandomStream::named(seed, name).next();
        assert_ne!(first(7, "frame 1"), first(7, "frame 2"));
        assert_ne!(first(7, "frame 1"), first(8, "frame 1"));
    }

    #[test]
    fn chosen_numbers_are_different_and_each_is_as_likely() {
        let mut stream = RandomStream::named(3, "choice");
        let mut counts = [0; 10];
        for _ in 0..10_000 {
            let mut chosen = stream.choose(3, 10);
            chosen.iter().for_each(|number| counts[*number] += 1);
            chosen.sort_unstable();
            chosen.dedup();
            assert_eq!(chosen.len(), 3);
        }
        // Four standard errors of a count of 3000 with variance 2100.
        assert!(counts.iter().all(|count| (count - 3000_i32).abs() < 184), "{counts:?}");
        assert_eq!(stream.choose(20, 4).len(), 4);
    }
}
