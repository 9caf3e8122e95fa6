//! Real captures beside the checkout, read and looked at; skipped, saying so, where they are not there.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use std::path::{Path, PathBuf};

use habitus_geometry::glam::DVec3;
use habitus_geometry::io::read_mesh;
use habitus_geometry::{
    FrameOfReference, SignedAxis, SurfaceIndex, Topology, TriangleMesh, guess_unit, guess_up_axis,
    vertex_normals,
};

/// Every `step`-th mesh of a capture, or nothing if the captures are not there.
fn frames(capture: &str, step: usize) -> Vec<TriangleMesh> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(capture);
    let Ok(entries) = std::fs::read_dir(&folder) else {
        println!("skipped: no captures in {}", folder.display());
        return Vec::new();
    };
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "ply"));
    paths.sort();
    paths.iter().step_by(step).map(|path| read_mesh(path).unwrap()).collect()
}

#[test]
fn up_and_unit_are_found_in_every_capture_however_it_is_turned_and_scaled() {
    for (capture, step) in [("crane", 20), ("dancer", 3), ("basketball_player", 3)] {
        let meshes = frames(capture, step);
        for up in SignedAxis::ALL {
            let frame = FrameOfReference { metres_per_unit: 0.001, up };
            let turned: Vec<Vec<DVec3>> = meshes
                .iter()
                .map(|mesh| mesh.positions().iter().map(|position| frame.to_input(*position)).collect())
                .collect();
            let together: Vec<&[DVec3]> = turned.iter().map(Vec::as_slice).collect();
            let Some(best) = guess_up_axis(&together).first().copied() else { continue };
            println!("{capture} {up}: {best:?}");
            assert_eq!(best.up, up, "{capture}");
            for alone in &together {
                let leading: Vec<SignedAxis> = guess_up_axis(&[alone]).iter().take(2).map(|c| c.up).collect();
                assert!(leading.contains(&up), "{capture}: {leading:?}");
            }
        }
        for mesh in meshes.iter().take(1) {
            let heights = mesh.positions().iter().map(|position| position.y);
            let stature =
                heights.clone().fold(f64::NEG_INFINITY, f64::max) - heights.fold(f64::INFINITY, f64::min);
            let guess = guess_unit(stature * 1000.0);
            println!("{capture}: {guess:?}");
            assert_eq!(guess.metres_per_unit, 0.001);
        }
    }
}

#[test]
fn captures_are_whole_meshes_whose_inside_is_inside() {
    for (capture, step, border_edges) in
        [("crane", 60, 0..=0), ("dancer", 10, 57..=83), ("basketball_player", 10, 0..=200)]
    {
        for mesh in frames(capture, step) {
            let topology = Topology::of_mesh(&mesh);
            let found = topology.boundary_edges().count();
            assert!(border_edges.contains(&found), "{capture} has {found} border edges");
            let index = SurfaceIndex::of_mesh(&mesh);
            let normals = vertex_normals(mesh.positions(), mesh.faces());
            // A step out of the skin is outside and a step in is inside, but in folds.
            let right = mesh
                .positions()
                .iter()
                .zip(&normals)
                .filter(|(position, normal)| {
                    index.signed_distance(**position + **normal * 1e-4) > 0.0
                        && index.signed_distance(**position - **normal * 1e-4) < 0.0
                })
                .count();
            assert!(right as f64 > 0.995 * normals.len() as f64, "{capture}: {right} of {}", normals.len());
        }
    }
}
