//! Kernels and frames of the main job beside their arithmetic floors.
//!
//! `cargo bench -p habitus --bench kernels [-- --export FOLDER]`. The export holds the meshes and the table, for
//! `benches/peers`. Best times are what the machine can do, medians what it did; floors say what counts and rates allow.
#![allow(clippy::print_stdout, clippy::expect_used, reason = "a program for a person at a terminal")]

use std::hint::black_box;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::DVec3;
use habitus::artifacts::journal::Journal;
use habitus::body::{BodyModel, BodySurface};
use habitus::fitting::Fit;
use habitus::fitting::correspondence::{ClosestField, CompatibilityRules};
use habitus::fitting::deformers::{BodyParameters, FreeParameters};
use habitus::fitting::terms::{ClosestPoints, DistanceForm};
use habitus::geometry::io::{Format, read_surface_bytes, write_cloud, write_mesh};
use habitus::geometry::{PointCloud, SurfaceIndex, TriangleMesh, vertex_normals};
use habitus::optimize::{Event, Flow, NormalEquations, Observer};
use habitus::stages::fit_sequence::{FitSequenceConfig, fit_sequence};
use habitus_synthetic::capture::CaptureSettings;
use habitus_synthetic::sequence::{DressedSequence, DressedSequenceSettings, generate};

#[path = "kernels/floors.rs"]
mod floors;

const REPEATS: usize = 30;
/// Queries that are timed together.
const PIECE: usize = 650;
/// Frames that are tracked; the first of them start the sequence.
const FRAME_COUNT: usize = 10;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let export = arguments
        .iter()
        .position(|argument| argument == "--export")
        .map(|place| PathBuf::from(arguments.get(place + 1).expect("--export names a folder")));
    let model = BodyModel::default_space().expect("the embedded model is valid");
    let sequence = capture(&model);
    let mut table = Table::default();

    // Kernels are timed on one core: a second one is the scheduler's business.
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread can be started");
    let mesh = &sequence.frames[0].capture;
    println!(
        "capture: {} vertices, {} triangles; body: {} vertices, {} components\n",
        mesh.positions().len(),
        mesh.faces().len(),
        model.vertex_count(),
        model.component_count()
    );
    one_core.install(|| {
        closest_points(&mut table, mesh, &sequence.frames[0].scene.body_vertices);
        body(&mut table, &model, &sequence);
        equations(&mut table, &model, &sequence);
        ply(&mut table, mesh);
    });
    frames(&mut table, &model, &sequence);
    table.print();
    if let Some(folder) = export {
        write_export(&folder, &model, &sequence, &table);
        println!("\nmeshes and table are in {}", folder.display());
    }
}

/// A person in a dress, captured with about 40k triangles; the cloth is coarse, as only its shape matters.
fn capture(model: &BodyModel) -> DressedSequence {
    let tiny = DressedSequenceSettings::tiny();
    let capture = CaptureSettings { voxel_mm: 15.0, ..CaptureSettings::default() };
    let settings = DressedSequenceSettings { frame_count: FRAME_COUNT, capture, ..tiny };
    generate(model, &settings, &mut |_, _| {}).expect("the settings are sound")
}

fn closest_points(table: &mut Table, mesh: &TriangleMesh, body: &[DVec3]) {
    let index = SurfaceIndex::of_mesh(mesh);
    let mut found = Vec::new();
    index.closest_many(body, None, &mut found);
    let hints: Vec<u32> = found.iter().map(|point| point.face).collect();
    // As between two rounds of a fit: everything has moved by three millimetres.
    let moved: Vec<DVec3> = body.iter().map(|point| *point + DVec3::new(0.002, -0.002, 0.001)).collect();
    let count = body.len();
    table.time_pieces("closest point, cold", floors::closest_cold(count).floor_ms(), count, |range| {
        for point in &body[range] {
            black_box(index.closest(*point));
        }
    });
    table.time_pieces("closest point, warm", floors::closest_warm(count).floor_ms(), count, |range| {
        for (point, hint) in moved[range.clone()].iter().zip(&hints[range]) {
            black_box(index.closest_warm(*point, *hint));
        }
    });
}

/// Some identity that is not the mean.
fn identity_of(model: &BodyModel) -> Vec<f64> {
    (0..model.component_count()).map(|k| (1.7 * k as f64).sin()).collect()
}

fn body(table: &mut Table, model: &BodyModel, sequence: &DressedSequence) {
    let surface = model.surface();
    let identity = identity_of(model);
    let pose = sequence.frames[0].scene.pose.parameters();
    let rest = surface.rest_vertices(&identity);
    let joints = surface.rest_joints(&identity);
    let mut vertices = Vec::new();
    table.time("skinning, fixed identity", floors::skinning(surface).floor_ms(), || {
        let posed = surface.skeleton().pose(&joints, pose);
        surface.skin_vertices_into(&rest, &posed, &mut vertices);
    });
    let floor = floors::identity(surface).floor_ms() + floors::skinning(surface).floor_ms();
    table.time("skinning, with identity", floor, || {
        let rest = surface.rest_vertices(&identity);
        let posed = surface.skeleton().pose(&surface.rest_joints(&identity), pose);
        surface.skin_vertices_into(&rest, &posed, &mut vertices);
    });
}

fn equations(table: &mut Table, model: &BodyModel, sequence: &DressedSequence) {
    let surface = model.surface();
    let frame = &sequence.frames[0];
    let vertices = &frame.scene.body_vertices;
    let normals = vertex_normals(vertices, model.faces());
    let field = ClosestField::find(&SurfaceIndex::of_mesh(&frame.capture), vertices, None);
    let pairs =
        field.correspondences(vertices, &normals, &CompatibilityRules { distance: 0.5, angle_deg: 180.0 });
    let term = ClosestPoints::new(&pairs, DistanceForm::Plane);
    let identity = identity_of(model);
    let pose = frame.scene.pose.parameters().to_vec();

    let of_pose = BodyParameters::of_pose(surface, &identity);
    let floor = floors::pose_equations(surface).floor_ms() + floors::skinning(surface).floor_ms();
    table.time("Gauss-Newton assembly, pose", floor, || {
        black_box(NormalEquations::of(&Fit::new(&of_pose).with(1.0, &term), &pose));
    });
    let of_both = BodyParameters::new(surface, FreeParameters::IdentityAndPose);
    let parameters = [identity, pose].concat();
    let floor = floor + floors::identity(surface).floor_ms() + floors::joint_equations(surface).floor_ms()
        - floors::pose_equations(surface).floor_ms()
        + floors::identity_equations(surface).floor_ms();
    table.time("Gauss-Newton assembly, pose and identity", floor, || {
        black_box(NormalEquations::of(&Fit::new(&of_both).with(1.0, &term), &parameters));
    });
}

fn ply(table: &mut Table, mesh: &TriangleMesh) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("capture.ply");
    write_mesh(&path, mesh).expect("it can be written");
    let bytes = std::fs::read(&path).expect("it was written");
    let floor = floors::ply(bytes.len(), mesh.positions().len(), mesh.faces().len()).floor_ms();
    table.time("PLY read, binary, from memory", floor, || {
        black_box(read_surface_bytes(Format::Ply, &bytes, &path).expect("it is whole"));
    });
}

/// When the stage reported what.
struct Clock(Vec<(&'static str, Instant)>);

impl Observer for Clock {
    fn on_event(&mut self, event: &Event) -> Flow {
        if let Event::Progress { stage, .. } = event {
            self.0.push((*stage, Instant::now()));
        }
        Flow::Continue
    }
}

impl Clock {
    /// Milliseconds between reports of one stage.
    fn intervals(&self, stage: &str) -> Vec<f64> {
        let pairs = self.0.windows(2).filter(|pair| pair.iter().all(|(name, _)| *name == stage));
        pairs.map(|pair| (pair[1].1 - pair[0].1).as_secs_f64() * 1e3).collect()
    }
}

/// Frames on all cores, as in a run: reading, indexing and sampling included.
fn frames(table: &mut Table, model: &BodyModel, sequence: &DressedSequence) {
    let config = FitSequenceConfig::default();
    let mut clock = Clock(Vec::new());
    fit_sequence(sequence, model, &config, &[], &mut Journal::none(), &mut clock).expect("it can be fitted");
    let fine = model.surface();
    let step = (fine.vertex_count() / config.track.coarse_vertex_count).max(1);
    let coarse: Vec<u32> = (0..fine.vertex_count() as u32).step_by(step).collect();
    let coarse: BodySurface = fine.subset(&coarse);
    let cores = rayon::current_num_threads() as f64;
    let floor = floors::tracked_frame(&coarse, fine, &config).floor_ms() / cores;
    table.add(&format!("one tracked frame, {cores} cores"), floor, clock.intervals("track"));
    let frames = FRAME_COUNT.min(config.refine.frame_limit) as f64;
    let passes: Vec<f64> = clock.intervals("refine").iter().map(|pass| pass / frames).collect();
    let shared = floors::identity_equations(fine).floor_ms() / frames;
    let floor = floors::refined_frame(fine, &config).floor_ms() / cores + shared;
    table.add(&format!("one frame of a refinement pass, {cores} cores"), floor, passes);
}

/// Times in milliseconds.
struct Row {
    name: String,
    best: f64,
    median: f64,
    floor: f64,
}

/// Milliseconds of each repetition; the first run warms caches and allocations and does not count.
fn times(task: &mut dyn FnMut()) -> Vec<f64> {
    let repetitions = (0..=REPEATS).map(|_| {
        let begun = Instant::now();
        task();
        begun.elapsed().as_secs_f64() * 1e3
    });
    repetitions.skip(1).collect()
}

#[derive(Default)]
struct Table {
    rows: Vec<Row>,
}

impl Table {
    fn time(&mut self, name: &str, floor: f64, mut task: impl FnMut()) {
        self.add(name, floor, times(&mut task));
    }

    /// Sums the best and the median times of pieces: on a shared machine a short piece runs undisturbed now and then.
    fn time_pieces(&mut self, name: &str, floor: f64, count: usize, mut task: impl FnMut(Range<usize>)) {
        let (mut best, mut median) = (0.0, 0.0);
        for start in (0..count).step_by(PIECE) {
            let mut times = times(&mut || task(start..(start + PIECE).min(count)));
            times.sort_by(f64::total_cmp);
            best += times[0];
            median += times[times.len() / 2];
        }
        self.rows.push(Row { name: name.into(), best, median, floor });
    }

    fn add(&mut self, name: &str, floor: f64, mut times: Vec<f64>) {
        times.sort_by(f64::total_cmp);
        let (best, median) = (times[0], times[times.len() / 2]);
        self.rows.push(Row { name: name.into(), best, median, floor });
    }

    fn print(&self) {
        println!(
            "{:<44}{:>10}{:>12}{:>11}{:>14}",
            "kernel", "best ms", "median ms", "floor ms", "best / floor"
        );
        for Row { name, best, median, floor } in &self.rows {
            println!("{name:<44}{best:>10.3}{median:>12.3}{floor:>11.4}{:>14.1}", best / floor);
        }
    }
}

/// What `benches/peers` needs to do the same work: the capture, the queries and their distances, identity, pose
/// and the posed body.
fn write_export(folder: &Path, model: &BodyModel, sequence: &DressedSequence, table: &Table) {
    std::fs::create_dir_all(folder).expect("the folder can be made");
    let frame = &sequence.frames[0];
    write_mesh(&folder.join("capture.ply"), &frame.capture).expect("it can be written");
    let cloud = |points: &[DVec3]| PointCloud::new(points.to_vec(), None).expect("finite points");
    write_cloud(&folder.join("queries.ply"), &cloud(&frame.scene.body_vertices)).expect("it can be written");
    let index = SurfaceIndex::of_mesh(&frame.capture);
    let distances: String = frame
        .scene
        .body_vertices
        .iter()
        .map(|point| format!("{}\n", index.closest(*point).distance_squared.sqrt()))
        .collect();
    std::fs::write(folder.join("distances.csv"), distances).expect("it can be written");
    let surface = model.surface();
    let identity = identity_of(model);
    let pose = frame.scene.pose.parameters();
    let posed = surface.skeleton().pose(&surface.rest_joints(&identity), pose);
    let body = surface.skin_vertices(&surface.rest_vertices(&identity), &posed);
    write_cloud(&folder.join("posed_body.ply"), &cloud(&body)).expect("it can be written");
    let line = |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let parameters = format!("{}\n{}\n", line(&identity), line(pose));
    std::fs::write(folder.join("parameters.csv"), parameters).expect("it can be written");
    let rows: String = table
        .rows
        .iter()
        .map(|row| format!("{},{},{},{}\n", row.name.replace(',', ";"), row.best, row.median, row.floor))
        .collect();
    let text = format!("kernel,best_ms,median_ms,floor_ms\n{rows}");
    std::fs::write(folder.join("kernels.csv"), text).expect("it can be written");
}
