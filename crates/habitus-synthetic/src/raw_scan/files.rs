//! Raw scans and depth pairs on disk.
//!
//! ```text
//! scans/<name>.ply  landmarks/<name>.csv  truth/<name>.ply  truth/<name>_rest.ply      raw scans
//! pairs/<name>/{front,back}.{png,ply}  pairs/<name>/intrinsics.json  landmarks/…  truth/…   depth pairs
//! template.ply  template_landmarks.csv  generated.json                                 both
//! ```

use std::path::{Path, PathBuf};

use glam::DVec3;
use habitus::artifacts::write_atomically;
use habitus::body::BodyModel;
use habitus::geometry::io::{write_cloud, write_mesh};
use habitus::geometry::{PointCloud, TriangleMesh};
use rayon::prelude::*;
use serde::Serialize;

use super::depth_pair::{DepthPairSettings, DepthView, make_depth_pair};
use super::landmarks::{LandmarkTable, PlacedLandmark};
use super::people::Population;
use super::{RawScanSettings, make_raw_scan};
use crate::error::SyntheticError;

/// The template's mean shape.
pub const TEMPLATE_FILE: &str = "template.ply";
/// Names and vertices of the template's landmarks.
pub const TEMPLATE_LANDMARKS_FILE: &str = "template_landmarks.csv";
/// What the folder was made with; written last.
const MANIFEST: &str = "generated.json";

/// `subject_0000` and so on.
pub fn subject_names(count: usize) -> Vec<String> {
    (0..count).map(|number| format!("subject_{number:04}")).collect()
}

#[derive(Serialize)]
struct Manifest<'a> {
    settings: &'a RawScanSettings,
    #[serde(skip_serializing_if = "Option::is_none")]
    cameras: Option<&'a DepthPairSettings>,
    subjects: &'a [String],
}

/// Makes raw scans of these people, in parallel; `progress` hears of each that is done.
pub fn write_raw_scans(
    model: &BodyModel,
    settings: &RawScanSettings,
    names: &[String],
    folder: &Path,
    progress: &(dyn Fn() + Sync),
) -> Result<(), SyntheticError> {
    let lab = Lab::open(model, settings, folder, "scans")?;
    names.par_iter().try_for_each(|name| {
        let scan = make_raw_scan(model, &lab.population, &lab.table, settings, name)?;
        write(&folder.join("scans").join(format!("{name}.ply")), &scan.mesh)?;
        lab.write_truth(name, &scan.person.vertices, &scan.landmarks)?;
        lab.write_rest(name, &scan.person.rest_vertices)?;
        progress();
        Ok::<(), SyntheticError>(())
    })?;
    write_json(&folder.join(MANIFEST), &Manifest { settings, cameras: None, subjects: names })
}

/// Makes front and back depth images of these people, in parallel; `progress` hears of each that is done.
pub fn write_depth_pairs(
    model: &BodyModel,
    settings: &RawScanSettings,
    cameras: &DepthPairSettings,
    names: &[String],
    folder: &Path,
    progress: &(dyn Fn() + Sync),
) -> Result<(), SyntheticError> {
    let lab = Lab::open(model, settings, folder, "pairs")?;
    names.par_iter().try_for_each(|name| {
        let pair = make_depth_pair(model, &lab.population, &lab.table, settings, cameras, name)?;
        let own = folder.join("pairs").join(name);
        make_folder(&own)?;
        for (side, view) in [("front", &pair.front), ("back", &pair.back)] {
            write_depth_view(&own, side, view)?;
            lab.write_truth(&format!("{name}_{side}"), &view.person.vertices, &view.landmarks)?;
        }
        write_json(&own.join("intrinsics.json"), &pair.front.image.intrinsics)?;
        lab.write_rest(name, &pair.front.person.rest_vertices)?;
        progress();
        Ok::<(), SyntheticError>(())
    })?;
    write_json(&folder.join(MANIFEST), &Manifest { settings, cameras: Some(cameras), subjects: names })
}

/// A folder of captures with what they are made from.
struct Lab<'a> {
    model: &'a BodyModel,
    folder: &'a Path,
    population: Population,
    table: LandmarkTable,
}

impl<'a> Lab<'a> {
    /// Checks the settings, makes the folders and writes the template.
    fn open(
        model: &'a BodyModel,
        settings: &RawScanSettings,
        folder: &'a Path,
        captures: &str,
    ) -> Result<Self, SyntheticError> {
        settings.check()?;
        let (population, table) = (Population::new(model)?, LandmarkTable::of(model));
        for part in [captures, "landmarks", "truth"] {
            make_folder(&folder.join(part))?;
        }
        write_template(model, &table, folder)?;
        Ok(Self { model, folder, population, table })
    }

    /// A captured body as it truly stood, and its landmarks.
    fn write_truth(
        &self,
        name: &str,
        vertices: &[DVec3],
        landmarks: &[PlacedLandmark],
    ) -> Result<(), SyntheticError> {
        write_landmarks(&self.folder.join("landmarks").join(format!("{name}.csv")), landmarks)?;
        write_body(self.model, &self.folder.join("truth").join(format!("{name}.ply")), vertices)
    }

    /// A person's true body at rest.
    fn write_rest(&self, name: &str, vertices: &[DVec3]) -> Result<(), SyntheticError> {
        write_body(self.model, &self.folder.join("truth").join(format!("{name}_rest.ply")), vertices)
    }
}

fn write_template(model: &BodyModel, table: &LandmarkTable, folder: &Path) -> Result<(), SyntheticError> {
    write_body(model, &folder.join(TEMPLATE_FILE), model.mean_vertices())?;
    let rows: Vec<String> = table.entries.iter().map(|(name, vertex)| format!("{name},{vertex}\n")).collect();
    write_text(&folder.join(TEMPLATE_LANDMARKS_FILE), &format!("landmark,vertex\n{}", rows.concat()))
}

fn write_depth_view(folder: &Path, side: &str, view: &DepthView) -> Result<(), SyntheticError> {
    let path = folder.join(format!("{side}.png"));
    let failed = |reason: String| SyntheticError::File { path: path.clone(), reason };
    let camera = &view.image.intrinsics;
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, camera.width as u32, camera.height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let pixels: Vec<u8> = view.image.depths.iter().flat_map(|depth| depth.to_be_bytes()).collect();
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&pixels))
        .map_err(|error| failed(error.to_string()))?;
    write_atomically(&path, &bytes).map_err(|error| failed(error.to_string()))?;
    let path = folder.join(format!("{side}.ply"));
    let cloud = PointCloud::new(view.image.points(), None)?;
    write_cloud(&path, &cloud).map_err(|error| SyntheticError::File { path, reason: error.to_string() })
}

fn write_landmarks(path: &Path, landmarks: &[PlacedLandmark]) -> Result<(), SyntheticError> {
    let rows: Vec<String> = landmarks
        .iter()
        .map(|landmark| {
            let DVec3 { x, y, z } = landmark.position;
            format!("{},{x:.6},{y:.6},{z:.6}\n", landmark.name)
        })
        .collect();
    write_text(path, &format!("landmark,x,y,z\n{}", rows.concat()))
}

fn write_body(model: &BodyModel, path: &Path, vertices: &[DVec3]) -> Result<(), SyntheticError> {
    write(path, &TriangleMesh::new(vertices.to_vec(), model.faces().to_vec())?)
}

fn write(path: &Path, mesh: &TriangleMesh) -> Result<(), SyntheticError> {
    write_mesh(path, mesh)
        .map_err(|error| SyntheticError::File { path: path.to_path_buf(), reason: error.to_string() })
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), SyntheticError> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|error| SyntheticError::File { path: path.to_path_buf(), reason: error.to_string() })?;
    write_text(path, &(text + "\n"))
}

fn write_text(path: &Path, text: &str) -> Result<(), SyntheticError> {
    write_atomically(path, text.as_bytes())
        .map_err(|error| SyntheticError::File { path: path.to_path_buf(), reason: error.to_string() })
}

fn make_folder(path: &PathBuf) -> Result<(), SyntheticError> {
    std::fs::create_dir_all(path)
        .map_err(|error| SyntheticError::File { path: path.clone(), reason: error.to_string() })
}
