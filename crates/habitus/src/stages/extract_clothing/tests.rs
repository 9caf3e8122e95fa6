//! A skirt of known shape around the figure of tubes: association, offsets, and what must be refused.

use std::f64::consts::TAU;

use glam::DVec3;
use habitus_geometry::{PointCloud, Surface, TriangleMesh};
use habitus_optimize::Silent;

use super::*;
use crate::artifacts::codes::Code;
use crate::artifacts::fixture::{largest_distance, rigged_sequence};
use crate::artifacts::frames::FramesInMemory;

const AROUND: u32 = 160;
const DOWN: u32 = 60;

/// A closed cone around both legs, from the waist to below the knees, whose front and back lie before and behind them.
fn skirt() -> TriangleMesh {
    let mut positions = Vec::new();
    for row in 0..=DOWN {
        for column in 0..AROUND {
            let angle = TAU * f64::from(column) / f64::from(AROUND);
            let (down, flare) = (f64::from(row) / f64::from(DOWN), 0.08 * f64::from(row) / f64::from(DOWN));
            let (x, z) = ((0.2 + flare) * angle.sin(), (0.13 + flare) * angle.cos());
            positions.push(DVec3::new(x, 0.98 - 0.66 * down, z));
        }
    }
    let mut faces = Vec::new();
    for row in 0..DOWN {
        for column in 0..AROUND {
            let at = |row: u32, column: u32| row * AROUND + column % AROUND;
            let (a, b) = (at(row, column), at(row, column + 1));
            let (c, d) = (at(row + 1, column), at(row + 1, column + 1));
            faces.extend([[a, c, b], [b, c, d]]);
        }
    }
    TriangleMesh::new(positions, faces).expect("a skirt")
}

/// The figure at rest, moved only as a whole from frame to frame, and the skirt with it, in the input's own coordinates.
fn rigid_sequence(frame_count: usize, clothing: &TriangleMesh) -> (RiggedSequence, FramesInMemory) {
    let mut fit = rigged_sequence(frame_count);
    for (frame, fitted) in fit.sequence.frames.iter_mut().enumerate() {
        let time = frame as f64;
        fitted.pose.fill(0.0);
        fitted.pose[..6].copy_from_slice(&[0.1 * time, 0.02, -0.3 * time, 0.2, 0.7 * time, 0.1]);
        fitted.codes.clear();
    }
    let surfaces = (0..frame_count)
        .map(|frame| {
            let root = fit.posed_skeleton(frame);
            let positions =
                clothing.positions().iter().map(|p| root.rotations[0] * *p + root.translations[0]);
            Surface::Mesh(in_input(&fit, frame, clothing, positions.collect()))
        })
        .collect();
    (fit, FramesInMemory { surfaces })
}

fn in_input(fit: &RiggedSequence, frame: usize, mesh: &TriangleMesh, metres: Vec<DVec3>) -> TriangleMesh {
    let scale = fit.sequence.frames[frame].capture_scale;
    let input = metres.iter().map(|p| fit.sequence.input_frame.to_input(*p) * scale).collect();
    mesh.with_positions(input).expect("as many")
}

fn extract(
    fit: &RiggedSequence,
    surfaces: &FramesInMemory,
    change: impl Fn(&mut AssociationConfig),
) -> Result<ExtractedClothing, ExtractClothingError> {
    let mut config = ExtractClothingConfig::default();
    change(&mut config.association);
    let rate = FrameRate::new(30.0).expect("a rate");
    extract_clothing(fit, DressedSurfaces::Captured(surfaces), None, rate, &config, &mut Silent)
}

#[test]
fn clothing_that_moves_rigidly_with_the_body_has_the_same_offsets_in_every_frame() {
    let (fit, surfaces) = rigid_sequence(5, &skirt());
    let extracted = extract(&fit, &surfaces, |_| {}).expect("extracts");
    let layer = &extracted.layer;
    assert_eq!((layer.frames.len(), extracted.left_out.len()), (5, 0));
    for frame in 1..5 {
        for (a, b) in layer.frame_offsets(0).iter().zip(layer.frame_offsets(frame)) {
            assert!((a - b).abs() < 1e-6, "an offset is {a} first and {b} in frame {frame}");
        }
    }
    // The rest body does not turn, so the offsets are the skirt minus its anchors.
    let anchors = layer.association.anchors(&layer.rest_vertices);
    for ((position, anchor), offset) in
        skirt().positions().iter().zip(&anchors).zip(layer.frame_offsets(0).as_chunks::<3>().0)
    {
        assert!((*position - *anchor).distance(DVec3::from_array(offset.map(f64::from))) < 1e-6);
    }
}

#[test]
fn the_layer_gives_the_captured_clothing_back() {
    let fit = rigged_sequence(6);
    let clothing = skirt();
    // Wild poses and a skirt that waves: whatever it does, the layer must hold it.
    let moved = |frame: usize| -> Vec<DVec3> {
        let root = fit.posed_skeleton(frame);
        let wave = |p: &DVec3| *p + DVec3::Z * 0.05 * (20.0 * p.y + frame as f64).sin();
        clothing.positions().iter().map(|p| root.rotations[0] * wave(p) + root.translations[0]).collect()
    };
    let surfaces = FramesInMemory {
        surfaces: (0..6).map(|frame| Surface::Mesh(in_input(&fit, frame, &clothing, moved(frame)))).collect(),
    };
    let extracted = extract(&fit, &surfaces, |_| {}).expect("extracts");
    // Frame 1 of the made-up fit has failed.
    assert_eq!(
        extracted.left_out.iter().map(|frame| frame.name.as_str()).collect::<Vec<_>>(),
        ["take, 0001.ply"]
    );
    assert!(extracted.left_out[0].reason.contains(Code::TooFewInliers.name()));
    let layer = &extracted.layer;
    assert_eq!(layer.frames.iter().map(|frame| frame.capture_index).collect::<Vec<_>>(), [0, 2, 3, 4, 5]);
    for (row, frame) in layer.frames.iter().enumerate() {
        let worst = largest_distance(&moved(frame.capture_index), &layer.clothing_vertices(row));
        // Offsets are kept in f32: 3e-8 m for each half metre, and at most fivefold by the limited stretch.
        assert!(worst < 3e-7, "frame {row} is {worst} m away");
        assert!(worst <= extracted.round_trip + 1e-9);
    }
}

/// Largest change of the left leg's share between neighbours of the front's and back's middle columns, below the pelvis.
fn largest_jump_across_the_middle(layer: &ClothingLayer) -> f64 {
    let skin = layer.association.blended_skin(&layer.rig);
    let left = |vertex: u32| -> f64 {
        skin.of(vertex as usize).filter(|(bone, _)| [1, 2, 3].contains(bone)).map(|(_, weight)| weight).sum()
    };
    let mut largest = 0.0_f64;
    for row in DOWN / 3..=DOWN {
        for column in 0..AROUND {
            let at = |column: u32| row * AROUND + column % AROUND;
            largest = largest.max((left(at(column)) - left(at(column + 1))).abs());
        }
    }
    largest
}

#[test]
fn a_skirt_has_a_seam_with_one_body_vertex_and_none_with_many() {
    let (fit, surfaces) = rigid_sequence(1, &skirt());
    let jump = |count: usize| {
        let extracted = extract(&fit, &surfaces, |config| {
            config.body_vertices_per_clothing_vertex = count;
            config.spreading.width_per_clearance = 0.0;
        });
        largest_jump_across_the_middle(&extracted.expect("extracts").layer)
    };
    assert!(jump(1) > 0.99, "one side hangs on the left leg alone, its neighbour on the right");
    // The columns are about a centimetre apart: the change is spread over the few that the diffusion reaches.
    assert!(jump(32) < 0.75, "{}", jump(32));
}

/// How much longer edges of the front and the back become when the legs part sideways by `angle` to each side: the edge
/// that grows most, and the mean of all on the hem, in metres.
fn openings_of_parted_legs(layer: &ClothingLayer, angle: f64) -> (f64, f64) {
    let skin = layer.association.blended_skin(&layer.rig);
    let anchors = layer.association.anchors(&layer.rest_vertices);
    let posed = |angle: f64| {
        let mut pose = vec![0.0; layer.rig.skeleton.pose_length()];
        for (parameter, axis) in layer.rig.skeleton.axes().iter().enumerate() {
            let side = match axis.bone {
                1 => 1.0,
                4 => -1.0,
                _ => continue,
            };
            pose[6 + parameter] = side * angle * axis.direction.z;
        }
        let posed = layer.rig.skeleton.pose(&layer.rest_joints, &pose);
        let carriers = skin.carriers(&anchors, &posed, layer.association.smallest_stretch);
        crate::artifacts::clothing_layer::pose_offsets(&carriers, layer.frame_offsets(0))
    };
    let (before, after) = (posed(0.0), posed(angle));
    let opening = |row: u32, column: u32| {
        let [a, b] = [column, column + 1].map(|column| (row * AROUND + column % AROUND) as usize);
        after[a].distance(after[b]) - before[a].distance(before[b])
    };
    let below = (DOWN / 3..=DOWN).flat_map(|row| (0..AROUND).map(move |column| (row, column)));
    let largest = below.map(|(row, column)| opening(row, column)).fold(0.0, f64::max);
    let hem = (0..AROUND).map(|column| opening(DOWN, column)).sum::<f64>() / f64::from(AROUND);
    (largest, hem)
}

#[test]
fn between_two_legs_a_skirt_opens_over_its_width_and_not_in_the_middle() {
    let (fit, surfaces) = rigid_sequence(1, &skirt());
    let openings = |change: fn(&mut SpreadingConfig)| {
        let extracted = extract(&fit, &surfaces, |config| change(&mut config.spreading));
        openings_of_parted_legs(&extracted.expect("extracts").layer, 0.3)
    };
    let (printed, of_printed_hem) = openings(|spreading| spreading.width_per_clearance = 0.0);
    let (spread, of_hem) = openings(|_| ());
    // An even spread over front and back would be twice the mean of the whole hem if its sides did not open at all.
    assert!(printed > 20.0 * of_printed_hem, "{printed} m where {of_printed_hem} m would be even");
    assert!(spread < 2.5 * of_hem, "{spread} m where {of_hem} m would be even");
    // The skirt still follows the legs: it is not left hanging on the hips, where they would come through.
    assert!(of_hem > 0.7 * of_printed_hem, "{of_hem} m instead of {of_printed_hem} m");
}

#[test]
fn without_a_width_the_bone_weights_are_those_of_the_body_vertices() {
    let (fit, surfaces) = rigid_sequence(2, &skirt());
    let layer = |width: f64| {
        let extracted = extract(&fit, &surfaces, |config| config.spreading.width_per_clearance = width);
        extracted.expect("extracts").layer
    };
    let (printed, spread) = (layer(0.0), layer(1.5));
    assert_eq!(printed.association.spread_skin, None);
    assert_eq!(
        printed.association.blended_skin(&fit.rig),
        spread.association.skin_of_body_vertices(&fit.rig)
    );
    // Where the clothing hangs does not change, only what turns it.
    assert_eq!(printed.association.body_vertices, spread.association.body_vertices);
    assert!(spread.association.spread_skin.is_some());
}

#[test]
fn vertices_that_no_ray_reaches_follow_their_neighbours_and_are_counted() {
    let (fit, surfaces) = rigid_sequence(1, &skirt());
    let all = extract(&fit, &surfaces, |_| {}).expect("extracts");
    let near = extract(&fit, &surfaces, |config| config.ray_length = 0.05).expect("extracts");
    let completed = |extracted: &ExtractedClothing| {
        let origins = &extracted.layer.association.origins;
        origins.iter().filter(|origin| **origin == AssociationOrigin::Completed).count()
    };
    assert!(near.paired_vertices < all.paired_vertices);
    assert!(completed(&near) > completed(&all) && completed(&near) < near.layer.clothing_vertex_count());
    for vertex in 0..near.layer.clothing_vertex_count() {
        let sum: f64 = near.layer.association.of(vertex).map(|(_, weight)| weight).sum();
        assert!((sum - 1.0).abs() < 1e-12);
    }
}

#[test]
fn a_loose_piece_hangs_on_the_nearest_body() {
    let mesh = skirt();
    let (mut positions, mut faces) = (mesh.positions().to_vec(), mesh.faces().to_vec());
    let first = positions.len() as u32;
    // A badge half a metre in front of the chest.
    positions.extend([[0.0, 1.3, 0.6], [0.05, 1.3, 0.6], [0.0, 1.35, 0.6]].map(DVec3::from_array));
    faces.push([first, first + 1, first + 2]);
    let with_badge = TriangleMesh::new(positions, faces).expect("a mesh");
    let (fit, surfaces) = rigid_sequence(2, &with_badge);
    let layer = extract(&fit, &surfaces, |_| {}).expect("extracts").layer;
    let skin = layer.association.blended_skin(&layer.rig);
    for vertex in first..first + 3 {
        assert_eq!(layer.association.origins[vertex as usize], AssociationOrigin::Completed);
        assert!(skin.of(vertex as usize).all(|(bone, _)| bone == 7), "the thorax carries it");
    }
}

#[test]
fn what_cannot_be_used_is_refused_or_left_out_by_name() {
    let (fit, mut surfaces) = rigid_sequence(3, &skirt());
    let last = surfaces.surfaces.pop().expect("three");
    assert!(matches!(
        extract(&fit, &surfaces, |_| {}),
        Err(ExtractClothingError::OtherFrames { fitted: 3, given: 2 })
    ));
    let Surface::Mesh(mesh) = &last else { panic!("a mesh") };
    let shorter = TriangleMesh::new(mesh.positions().to_vec(), mesh.faces()[1..].to_vec()).expect("a mesh");
    surfaces.surfaces.push(Surface::Mesh(shorter));
    let extracted = extract(&fit, &surfaces, |_| {}).expect("extracts");
    assert_eq!((extracted.layer.frames.len(), extracted.left_out.len()), (2, 1));
    assert!(extracted.left_out[0].reason.contains("faces"), "{}", extracted.left_out[0].reason);

    let cloud = PointCloud::new(vec![DVec3::ZERO], None).expect("a cloud");
    let clouds = FramesInMemory { surfaces: vec![Surface::Cloud(cloud); 3] };
    assert!(matches!(extract(&fit, &clouds, |_| {}), Err(ExtractClothingError::NoUsableFrame { .. })));
    let far: Vec<DVec3> = skirt().positions().iter().map(|p| *p + DVec3::X * 40.0).collect();
    let (_, elsewhere) = rigid_sequence(3, &skirt().with_positions(far).expect("as many"));
    assert!(matches!(extract(&fit, &elsewhere, |_| {}), Err(ExtractClothingError::NoPair { .. })));
    let none = extract(&fit, &surfaces, |config| config.body_vertices_per_clothing_vertex = 0);
    assert!(matches!(none, Err(ExtractClothingError::Setting { .. })));
    let none = extract(&fit, &surfaces, |config| config.spreading.smallest_share = 1.5);
    assert!(none.is_err_and(|error| error.to_string().contains("smallest_share")));
    let none = extract(&fit, &surfaces, |config| config.spreading.width_per_clearance = -1.0);
    assert!(none.is_err_and(|error| error.to_string().contains("width_per_clearance")));
    let none = extract(&fit, &surfaces, |config| config.diffusion_radius = f64::NAN);
    assert!(none.is_err_and(|error| error.to_string().contains("diffusion_radius")));
}
