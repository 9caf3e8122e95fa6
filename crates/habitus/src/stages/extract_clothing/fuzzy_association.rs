//! Fuzzy dense association (P3 §3.1): pairs are spread over clothing and body by Gaussians of geodesic distance.
//!
//! Eq. 2 sums exp(−(r_C + r_B)/σ²) over pairs, with r squared distances: a product of one factor on the clothing and
//! one on the body. Over all vertices it is P = W_C · S · W_Bᵀ, with sparse kernels W and the 0–1 matrix S of pairs.

use habitus_geometry::Geodesics;
use rayon::prelude::*;

use super::config::AssociationConfig;
use super::sparse_association::SparsePair;

/// Clothing vertices per parallel piece.
const VERTEX_CHUNK: usize = 128;

/// The heaviest body vertices of one clothing vertex, by falling weight; empty where no pair is near.
pub(super) type Slots = Vec<(u32, f64)>;

/// P3 Eq. 2: for each clothing vertex its n_f body vertices of the highest association probability, normalised.
pub(super) fn diffuse(
    pairs: &[SparsePair],
    clothing: &Geodesics,
    body: &Geodesics,
    config: &AssociationConfig,
) -> Vec<Slots> {
    let clothing_sources: Vec<u32> = pairs.iter().map(|pair| pair.clothing).collect();
    let body_sources: Vec<u32> = pairs.iter().map(|pair| pair.body).collect();
    let clothing_kernel = kernel(clothing, &clothing_sources, config);
    let body_kernel = kernel(body, &body_sources, config);

    // W_C by its rows: for each clothing vertex the pairs near it.
    let mut pairs_near: Vec<Vec<(u32, f64)>> = vec![Vec::new(); clothing.vertex_count()];
    for (pair, near) in clothing_kernel.iter().enumerate() {
        for (vertex, weight) in near {
            pairs_near[*vertex as usize].push((pair as u32, *weight));
        }
    }
    pairs_near
        .par_iter()
        .with_min_len(VERTEX_CHUNK)
        .map_init(
            || vec![0.0; body.vertex_count()],
            |sums, near| {
                let mut touched: Vec<u32> = Vec::new();
                for (pair, clothing_weight) in near {
                    for (vertex, body_weight) in &body_kernel[*pair as usize] {
                        let sum = &mut sums[*vertex as usize];
                        if *sum == 0.0 {
                            touched.push(*vertex);
                        }
                        *sum += clothing_weight * body_weight;
                    }
                }
                let probabilities: Slots = touched
                    .iter()
                    .map(|vertex| (*vertex, std::mem::take(&mut sums[*vertex as usize])))
                    .collect();
                heaviest(probabilities, config.body_vertices_per_clothing_vertex)
            },
        )
        .collect()
}

/// The columns of W for some vertices: exp(−r²/σ²) of each vertex within reach.
fn kernel(geodesics: &Geodesics, sources: &[u32], config: &AssociationConfig) -> Vec<Vec<(u32, f64)>> {
    let variance = config.diffusion_radius * config.diffusion_radius;
    let mut columns = geodesics.within_many(sources, config.diffusion_reach);
    columns.par_iter_mut().for_each(|column| {
        column.iter_mut().for_each(|(_, distance)| *distance = (-*distance * *distance / variance).exp());
    });
    columns
}

/// The `count` heaviest entries by falling weight (of equal ones the lower vertex first), with a sum of one.
pub(super) fn heaviest(mut entries: Slots, count: usize) -> Slots {
    entries.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    entries.truncate(count.max(1));
    let sum: f64 = entries.iter().map(|(_, weight)| weight).sum();
    entries.iter_mut().for_each(|(_, weight)| *weight /= sum);
    entries
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    /// A strip of vertices one centimetre apart, two wide.
    fn strip(length: u32) -> Geodesics {
        let positions: Vec<DVec3> = (0..2 * length)
            .map(|k| DVec3::new(0.01 * f64::from(k / 2), 0.01 * f64::from(k % 2), 0.0))
            .collect();
        let faces: Vec<[u32; 3]> = (0..length - 1)
            .flat_map(|k| [[2 * k, 2 * k + 2, 2 * k + 1], [2 * k + 1, 2 * k + 2, 2 * k + 3]])
            .collect();
        Geodesics::new(&positions, &faces)
    }

    #[test]
    fn diffusion_is_equation_2_summed_pair_by_pair() {
        let (clothing, body) = (strip(12), strip(15));
        let pairs: Vec<SparsePair> = [(3, 4), (9, 8), (10, 21), (12, 2)]
            .map(|(clothing, body)| SparsePair { clothing, body })
            .to_vec();
        let slots = 7;
        let config = AssociationConfig { body_vertices_per_clothing_vertex: slots, ..Default::default() };
        let found = diffuse(&pairs, &clothing, &body, &config);
        for vertex in 0..clothing.vertex_count() as u32 {
            let mut printed = vec![0.0; body.vertex_count()];
            for pair in &pairs {
                for (k, r_clothing) in clothing.within(pair.clothing, 0.03) {
                    for (l, r_body) in body.within(pair.body, 0.03) {
                        if k == vertex {
                            let squares = r_clothing * r_clothing + r_body * r_body;
                            printed[l as usize] += (-squares / (0.01 * 0.01)).exp();
                        }
                    }
                }
            }
            let mut expected: Slots =
                (0..).zip(printed).filter(|(_, probability)| *probability > 0.0).collect();
            expected.sort_by(|a, b| b.1.total_cmp(&a.1));
            expected.truncate(slots);
            let sum: f64 = expected.iter().map(|(_, p)| p).sum();
            assert_eq!(found[vertex as usize].len(), expected.len());
            let mut weights = found[vertex as usize].iter().zip(&expected);
            assert!(weights.all(|((_, found), (_, printed))| (found - printed / sum).abs() < 1e-12));
        }
        assert!(found[23].is_empty(), "no pair is within three centimetres of the strip's end");
    }
}
