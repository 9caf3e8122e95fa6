//! One deformer with weighted terms: an objective.

use habitus_optimize::{Objective, Sink};

use super::deformer::{DeformedSurface, Deformer};

/// One energy of a bent surface, with its correspondences frozen inside.
pub trait Term {
    /// The term's name in messages.
    fn name(&self) -> &'static str;

    /// Adds `weight` times the term's residuals.
    fn add_to(&self, surface: &dyn DeformedSurface, parameters: &[f64], weight: f64, sink: &mut dyn Sink);
}

/// `E(parameters) = Σ weight · term(deformer(parameters))` (P1 Eq. 7, P2 Eq. 4).
pub struct Fit<'a> {
    deformer: &'a dyn Deformer,
    terms: Vec<(f64, &'a dyn Term)>,
}

impl<'a> Fit<'a> {
    /// A fit without terms.
    pub fn new(deformer: &'a dyn Deformer) -> Self {
        Self { deformer, terms: Vec::new() }
    }

    /// Adds a term; a term of weight zero is left out.
    #[must_use]
    pub fn with(mut self, weight: f64, term: &'a dyn Term) -> Self {
        if weight != 0.0 {
            self.terms.push((weight, term));
        }
        self
    }
}

impl Objective for Fit<'_> {
    fn parameter_count(&self) -> usize {
        self.deformer.parameter_count()
    }

    fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink) {
        let surface = self.deformer.deform(parameters);
        for (weight, term) in &self.terms {
            sink.begin_part(term.name());
            term.add_to(surface.as_ref(), parameters, *weight, sink);
        }
    }
}
