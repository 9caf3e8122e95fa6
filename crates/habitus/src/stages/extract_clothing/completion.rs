//! Clothing vertices that no pair reaches: they follow their neighbours on the clothing. P3 is silent about them.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, Topology, TriangleMesh};

use super::fuzzy_association::{Slots, heaviest};

/// Fills the empty slots outwards from those that are not, then evens them out, so that two fronts that meet (left and
/// right leg at the hem of a skirt) blend into one another instead of forming a seam. Returns who was filled.
///
/// Deviation: P3 §3.1 leaves the probabilities of such vertices at zero.
pub(super) fn complete(
    slots: &mut [Slots],
    topology: &Topology,
    clothing: &TriangleMesh,
    body: &TriangleMesh,
    slot_count: usize,
    smoothing_rounds: usize,
) -> Vec<bool> {
    let is_completed: Vec<bool> = slots.iter().map(Vec::is_empty).collect();
    let mut filled: Vec<u32> = Vec::new();
    let mut front: Vec<u32> = (0..slots.len() as u32)
        .filter(|vertex| slots[*vertex as usize].is_empty() && has_filled_neighbour(slots, topology, *vertex))
        .collect();
    while !front.is_empty() {
        // All of a ring at once, so that the result does not hang on the order within it.
        let ring: Vec<Slots> =
            front.iter().map(|vertex| mean_of_neighbours(slots, topology, *vertex, slot_count)).collect();
        for (vertex, mean) in front.iter().zip(ring) {
            slots[*vertex as usize] = mean;
        }
        let mut next: Vec<u32> = front
            .iter()
            .flat_map(|vertex| topology.one_ring(*vertex as usize))
            .copied()
            .filter(|vertex| slots[*vertex as usize].is_empty())
            .collect();
        next.sort_unstable();
        next.dedup();
        filled.append(&mut front);
        front = next;
    }
    for _ in 0..smoothing_rounds {
        let smoothed: Vec<Slots> =
            filled.iter().map(|vertex| mean_of_neighbours(slots, topology, *vertex, slot_count)).collect();
        for (vertex, mean) in filled.iter().zip(smoothed) {
            slots[*vertex as usize] = mean;
        }
    }
    hang_loose_parts_on_the_nearest_body(slots, clothing, body);
    is_completed
}

fn has_filled_neighbour(slots: &[Slots], topology: &Topology, vertex: u32) -> bool {
    topology.one_ring(vertex as usize).iter().any(|neighbour| !slots[*neighbour as usize].is_empty())
}

fn mean_of_neighbours(slots: &[Slots], topology: &Topology, vertex: u32, slot_count: usize) -> Slots {
    let neighbours = topology.one_ring(vertex as usize).iter().map(|neighbour| &slots[*neighbour as usize]);
    let mut entries: Slots = neighbours.flatten().copied().collect();
    entries.sort_unstable_by_key(|(body, _)| *body);
    entries.dedup_by(|next, kept| {
        let is_same = next.0 == kept.0;
        if is_same {
            kept.1 += next.1;
        }
        is_same
    });
    heaviest(entries, slot_count)
}

/// A component without any pair has no neighbours to follow: it hangs on the nearest point of the body.
fn hang_loose_parts_on_the_nearest_body(slots: &mut [Slots], clothing: &TriangleMesh, body: &TriangleMesh) {
    if slots.iter().all(|entries| !entries.is_empty()) {
        return;
    }
    let index = SurfaceIndex::of_mesh(body);
    for (entries, position) in slots.iter_mut().zip(clothing.positions()) {
        if entries.is_empty() {
            let nearest = index.closest(*position);
            let corners = body.faces()[nearest.face as usize];
            let weighted = corners.into_iter().zip(nearest.barycentric).filter(|(_, weight)| *weight > 0.0);
            *entries = heaviest(weighted.collect(), DVec3::AXES.len());
        }
    }
}
