//! Makes dressed sequences and paints contact sheets of them: truth above, capture below.
//!
//! `cargo run --release --example dressed_sequence -- <picture folder> [outfit] [motion] [frames] [model.npz]`; the
//! motion is a name or a motion file, and a fabric may follow the outfit: `dress:silk-satin`.

#![allow(clippy::print_stdout, reason = "an example talks to the one who runs it")]

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::{DVec3, Vec3};
use habitus::body::BodyModel;
use habitus_synthetic::depth_map::{Camera, DepthMap, NO_FACE};
use habitus_synthetic::sequence::{DressedSequenceSettings, Performance, Stage};

const SIZE: (usize, usize) = (300, 480);

type Meshes<'a> = Vec<(&'a [DVec3], &'a [[u32; 3]])>;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = PathBuf::from(arguments.first().ok_or("name a folder for the pictures")?);
    std::fs::create_dir_all(&folder)?;
    let word =
        |place: usize, default: &str| format!("\"{}\"", arguments.get(place).map_or(default, |word| word));
    let outfit = word(1, "dress").replace('"', "");
    let (outfit, fabric) =
        outfit.split_once(':').map_or((outfit.as_str(), None), |(o, f)| (o, Some(f.into())));
    let motion_file = arguments.get(2).map(PathBuf::from).filter(|path| path.is_file());
    let motion = if motion_file.is_some() { "\"walk\"".into() } else { word(2, "walk_and_turn") };
    let settings = DressedSequenceSettings {
        outfit: serde_json::from_str(&format!("\"{outfit}\""))?,
        motion: serde_json::from_str(&motion)?,
        motion_file,
        fabric,
        frame_count: arguments.get(3).map_or(Ok(60), |count| count.parse())?,
        ..DressedSequenceSettings::default()
    };
    let model = match arguments.get(4) {
        Some(path) => BodyModel::load(Path::new(path))?,
        None => BodyModel::default_space()?,
    };
    let start = Instant::now();
    let rest_vertices = habitus_synthetic::source_bodies::source_body(&model, settings.source_body)?;
    let mut performance = Performance::new(&model, rest_vertices, &settings)?;
    for garment in performance.garments() {
        let (vertices, faces) = (garment.positions.len(), garment.faces.len());
        println!("{}: {vertices} vertices, {faces} faces, {} stitches", garment.name, garment.anchors.len());
    }
    println!("tailoring {:.2} s", start.elapsed().as_secs_f64());
    let body = performance.body();
    let mut rest: Meshes<'_> = vec![(body.positions(), body.faces())];
    rest.extend(
        performance.garments().iter().map(|garment| (garment.positions.as_slice(), garment.faces.as_slice())),
    );
    let views: Vec<_> = [0.0, 0.8, 1.6, 3.2].into_iter().map(|yaw| paint(&rest, yaw)).collect();
    save(&folder.join("cut.png"), &[views])?;

    let stage = Stage::of(&performance);
    let wanted = 8;
    let every = settings.frame_count.div_ceil(wanted);
    let mut rows = vec![Vec::new(), Vec::new(), Vec::new()];
    let mut seconds = [0.0; 2];
    let mut triangles = 0;
    for index in 0..settings.frame_count {
        let start = Instant::now();
        let scene = performance.next_scene()?;
        seconds[0] += start.elapsed().as_secs_f64();
        if index % every == 0 {
            let subjects = stage.subjects(&scene);
            let meshes: Meshes<'_> =
                subjects.iter().map(|subject| (subject.positions, subject.faces)).collect();
            rows[0].push(paint(&meshes, 0.5));
            rows[1].push(paint(&meshes, 2.2));
        }
        let start = Instant::now();
        let frame = stage.capture(index, scene)?;
        seconds[1] += start.elapsed().as_secs_f64();
        triangles += frame.capture.faces().len();
        if index % every == 0 {
            rows[2].push(paint(&vec![(frame.capture.positions(), frame.capture.faces())], 0.5));
        }
    }
    println!("{} frames: simulated {:.2} s, captured {:.2} s", settings.frame_count, seconds[0], seconds[1]);
    println!("{} triangles each", triangles / settings.frame_count);
    for cloth in performance.cloths() {
        let mut ratios: Vec<f64> = cloth.stretch_ratios().collect();
        ratios.sort_by(f64::total_cmp);
        let at = |share: f64| ratios[(ratios.len() as f64 * share) as usize];
        println!("stretch median {:.3}, p95 {:.3}, p99.9 {:.3}", at(0.5), at(0.95), at(0.999));
    }
    save(&folder.join("sequence.png"), &rows)?;
    Ok(())
}

/// A shaded view; each mesh has its own colour.
fn paint(meshes: &Meshes<'_>, yaw: f64) -> Vec<[u8; 3]> {
    let points = || meshes.iter().flat_map(|(positions, _)| positions.iter().copied());
    let low = points().fold(DVec3::INFINITY, DVec3::min);
    let high = points().fold(DVec3::NEG_INFINITY, DVec3::max);
    let middle = (low + high) * 0.5;
    let eye = middle + DVec3::new(yaw.sin(), 0.15, yaw.cos()) * 5.0;
    let camera = Camera::looking_at(eye, middle, SIZE.1 as f64 * 2.5, SIZE.0, SIZE.1);
    let map = DepthMap::render(camera, meshes);
    let ends: Vec<usize> = meshes
        .iter()
        .scan(0, |end, (_, faces)| {
            *end += faces.len();
            Some(*end)
        })
        .collect();
    let colours = [[225.0, 180.0, 150.0], [110.0, 140.0, 215.0], [200.0, 110.0, 110.0]];
    let light = Vec3::new(-0.4, -0.6, -0.7).normalize();
    map.face
        .iter()
        .map(|&face| {
            if face == NO_FACE {
                return [255, 255, 255];
            }
            let mesh = ends.iter().position(|&end| (face as usize) < end).unwrap_or(0);
            let shade = 0.25 + 0.75 * map.planes[face as usize].normal.dot(light).max(0.0);
            colours[mesh % 3].map(|channel: f32| (channel * shade) as u8)
        })
        .collect()
}

fn save(path: &Path, rows: &[Vec<Vec<[u8; 3]>>]) -> Result<(), Box<dyn std::error::Error>> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let (width, height) = (SIZE.0 * columns, SIZE.1 * rows.len());
    let mut pixels = vec![255_u8; width * height * 3];
    for (row, tiles) in rows.iter().enumerate() {
        for (column, tile) in tiles.iter().enumerate() {
            for y in 0..SIZE.1 {
                let start = ((row * SIZE.1 + y) * width + column * SIZE.0) * 3;
                let line = tile[y * SIZE.0..(y + 1) * SIZE.0].as_flattened();
                pixels[start..start + line.len()].copy_from_slice(line);
            }
        }
    }
    let mut encoder = png::Encoder::new(std::fs::File::create(path)?, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header()?.write_image_data(&pixels)?;
    Ok(())
}
