//! `habitus reconstruct`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, bail};
use clap::Args;
use habitus::artifacts::depth_image::DepthImage;
use habitus::artifacts::provenance::Provenance;
use habitus::artifacts::write_atomically;
use habitus::geometry::io::{read_surface, write_mesh};
use habitus::geometry::{Surface, TriangleMesh};
use habitus::stages::reconstruct::{PartialView, ReconstructConfig, Side, reconstruct};

use super::learn_shape::BarObserver;
use crate::Outcome;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::StageBar;
use crate::sequence_job::load_model;

const EXAMPLES: &str = "\
Examples:
  habitus reconstruct front.png back.png -o run
  habitus reconstruct front.ply back.ply -o run --model mine.npz

FRONT and BACK are depth images (16-bit grey PNG, with intrinsics.json beside them) or partial
meshes or clouds in the camera's frame: metres, x right, y up, looking along -z. The person stands
upright and whole in both, facing the camera in FRONT and away from it in BACK.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ReconstructArguments {
    /// View from the front
    pub front: PathBuf,
    /// View from the back
    pub back: PathBuf,
    /// Folder for the results
    #[arg(long, short, value_name = "RUN")]
    pub output: PathBuf,
    /// Body model [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Intrinsics of both images [default: intrinsics.json beside each]
    #[arg(long, value_name = "FILE")]
    pub intrinsics: Option<PathBuf>,
    /// Settings of the stage
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Reconstructs a body.
pub fn run(arguments: &ReconstructArguments, console: &Console) -> anyhow::Result<Outcome> {
    let start = Instant::now();
    let config = arguments.settings.load()?.reconstruct;
    let model = load_model(arguments.model.as_deref())?;
    let intrinsics = arguments.intrinsics.as_deref();
    let views = [
        read_view(&arguments.front, Side::Front, intrinsics, &config)?,
        read_view(&arguments.back, Side::Back, intrinsics, &config)?,
    ];
    let mut observer = BarObserver(StageBar::new(console));
    let found = reconstruct(&views, &model, &config, &mut observer);
    observer.0.clear();
    let found = found?;
    let folder = &arguments.output;
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    let bodies = [
        ("body_rest.ply", found.rest_vertices.clone()),
        ("body_front.ply", found.posed_vertices[0].clone()),
        ("body_back.ply", found.posed_vertices[1].clone()),
    ];
    for (name, vertices) in bodies {
        write_mesh(&folder.join(name), &TriangleMesh::new(vertices, model.faces().to_vec())?)?;
    }
    let summary = serde_json::json!({
        "verb": "reconstruct",
        "version": env!("CARGO_PKG_VERSION"),
        "model": model.metadata().name,
        "identity": found.identity,
        "poses": { "front": found.poses[0], "back": found.poses[1] },
        "residual_mm": { "front": 1000.0 * found.residuals[0], "back": 1000.0 * found.residuals[1] },
        "seconds": start.elapsed().as_secs_f64(),
    });
    let path = folder.join("summary.json");
    write_atomically(&path, (serde_json::to_string_pretty(&summary)? + "\n").as_bytes())
        .with_context(|| format!("{}: cannot be written", path.display()))?;
    Provenance::new("reconstruct", &config, 0)?
        .with_model(&model)
        .with_inputs(&[arguments.front.clone(), arguments.back.clone()])?
        .write(&folder.join("provenance.toml"))?;
    console.note(format!(
        "mean distance: front {:.1} mm, back {:.1} mm",
        1000.0 * found.residuals[0],
        1000.0 * found.residuals[1]
    ));
    console.result(folder.join("body_rest.ply").display());
    Ok(Outcome::Fine)
}

/// A view from an image, a mesh or a cloud.
pub(super) fn read_view(
    path: &Path,
    side: Side,
    intrinsics: Option<&Path>,
    config: &ReconstructConfig,
) -> anyhow::Result<PartialView> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
        let beside = path.with_file_name("intrinsics.json");
        let intrinsics = intrinsics.unwrap_or(&beside);
        if !intrinsics.is_file() {
            bail!(
                "{}: a depth image needs its intrinsics; write {} or give --intrinsics",
                path.display(),
                intrinsics.display()
            );
        }
        return Ok(PartialView::of_depth(side, &DepthImage::read(path, intrinsics)?, config)?);
    }
    Ok(match read_surface(path)? {
        Surface::Mesh(mesh) => PartialView::of_mesh(side, &mesh)?,
        Surface::Cloud(cloud) => PartialView::of_cloud(side, &cloud),
    })
}
