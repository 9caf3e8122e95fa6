//! Several kernel regressors, each for its own part of the output.
//!
//! What moves a sleeve is the arm in it. A part's regressor compares inputs by their relevance for that part, and its
//! outputs enter the sum through a matrix that picks the part: `f(x) = Σ_p f_p(x) M_p` with `Σ_p M_p = I`. For parts of a
//! surface in the coordinates of a linear space, `M_p = basisᵀ · diag(mask_p) · basis`.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::kernel_ridge::{
    KernelChoice, KernelRidge, KernelRidgeConfig, KernelRidgeError, Samples, evenly_spread,
    misses_of_left_out_blocks,
};

/// One part of the output.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelPart {
    /// What the part's regressor says about all outputs.
    pub regressor: KernelRidge,
    /// M_p, outputs × outputs.
    pub mixing: DMatrix<f64>,
}

/// A sum of regressors.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelMixture {
    /// Inputs of the rows that all parts keep.
    pub inputs: DMatrix<f64>,
    /// The parts.
    pub parts: Vec<KernelPart>,
}

impl KernelMixture {
    /// Learns one regressor for each pair of a relevance of the inputs and a mixing matrix.
    pub fn learn(
        samples: &Samples<'_>,
        parts: Vec<(Vec<f64>, DMatrix<f64>)>,
        choice: &KernelChoice,
        most_rows: usize,
    ) -> Result<Self, KernelRidgeError> {
        let kept = evenly_spread(samples.inputs.nrows(), most_rows);
        let (inputs, targets) = (samples.inputs.select_rows(&kept), samples.targets.select_rows(&kept));
        let kept = Samples { inputs: &inputs, targets: &targets, ..*samples };
        let parts: Result<Vec<KernelPart>, KernelRidgeError> = parts
            .into_par_iter()
            .map(|(relevance, mixing)| {
                let regressor = KernelRidge::learn_with(&kept, &relevance, choice)?;
                Ok(KernelPart { regressor, mixing })
            })
            .collect();
        Ok(Self { parts: parts?, inputs })
    }

    /// Sum of squared errors on rows that the mixture was not learnt from; see [`KernelChoice::by_left_out_blocks`].
    pub fn left_out_error(
        samples: &Samples<'_>,
        parts: &[(Vec<f64>, DMatrix<f64>)],
        choice: &KernelChoice,
        config: &KernelRidgeConfig,
    ) -> Result<f64, KernelRidgeError> {
        // As the mixing matrices sum to the identity, what the mixture misses is the mixture of what its parts miss.
        let of_part = |(relevance, mixing): &(Vec<f64>, DMatrix<f64>)| {
            let misses = misses_of_left_out_blocks(samples, relevance, choice, config)?;
            Ok(misses.into_iter().map(|missed| missed * mixing).collect())
        };
        let misses: Vec<Vec<DMatrix<f64>>> = parts.par_iter().map(of_part).collect::<Result<_, _>>()?;
        let mut of_parts = misses.into_iter();
        let Some(mut sums) = of_parts.next() else { return Ok(0.0) };
        for part in of_parts {
            sums.iter_mut().zip(part).for_each(|(sum, missed)| *sum += missed);
        }
        Ok(sums.iter().map(DMatrix::norm_squared).sum())
    }

    /// Outputs for rows of inputs.
    pub fn predict(&self, inputs: &DMatrix<f64>) -> DMatrix<f64> {
        let outputs: Vec<DMatrix<f64>> =
            self.parts.par_iter().map(|part| part.regressor.predict(inputs) * &part.mixing).collect();
        let width = self.parts.first().map_or(0, |part| part.mixing.ncols());
        outputs.into_iter().fold(DMatrix::zeros(inputs.nrows(), width), |sum, part| sum + part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::RandomStream;

    #[test]
    fn parts_with_one_relevance_are_the_whole() {
        let mut random = RandomStream::named(2, "mixture");
        let inputs = DMatrix::from_fn(30, 3, |_, _| random.normal());
        let targets = DMatrix::from_fn(30, 2, |row, k| inputs[(row, k)].sin());
        let relevance = [1.0, 0.5, 2.0];
        let config = KernelRidgeConfig::default();
        let samples = Samples::of_one_sequence(&inputs, &targets);
        let choice = KernelChoice::by_left_out_blocks(&samples, &relevance, &config).unwrap();
        let whole = KernelRidge::learn_with(&samples, &relevance, &choice).unwrap();
        let some = DMatrix::from_row_slice(2, 2, &[0.7, 0.2, 0.2, 0.4]);
        let rest = DMatrix::identity(2, 2) - &some;
        let parts = vec![(relevance.to_vec(), some), (relevance.to_vec(), rest)];
        let mixture = KernelMixture::learn(&samples, parts, &choice, 100).unwrap();
        assert!((mixture.predict(&inputs) - whole.predict(&inputs)).norm() < 1e-10);
        let some = DMatrix::from_row_slice(2, 2, &[0.7, 0.2, 0.2, 0.4]);
        let rest = DMatrix::identity(2, 2) - &some;
        let parts = [(relevance.to_vec(), some), (relevance.to_vec(), rest)];
        let error = KernelMixture::left_out_error(&samples, &parts, &choice, &config).unwrap();
        assert!((error - choice.left_out_error).abs() < 1e-9 * choice.left_out_error);
    }
}
