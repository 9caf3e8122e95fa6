//! `synthesize --interactive`: the dressing room of a model, served to this machine alone.

use anyhow::{Context, bail};
use habitus::artifacts::clothing_model::ClothingModel;
use habitus::artifacts::fabric::{Fabric, named_fabrics};
use habitus::stages::synthesize::Motion;
use habitus_report::dressing_room::{DressingRoom, RoomFabric, RoomMotion};

use super::dressing_pages::DressingPages;
use super::{SynthesizeArguments, controls_of, find_motion};
use crate::Outcome;
use crate::console::Console;
use crate::local_server::LocalServer;
use crate::sequence_job::load_model;
use crate::side_page::title_of;

/// Serves the dressing room until Ctrl-C.
pub fn serve(
    arguments: &SynthesizeArguments,
    mut model: ClothingModel,
    console: &Console,
) -> anyhow::Result<Outcome> {
    // The sliders start where the options say.
    let controls = controls_of(arguments, &model)?;
    model.controls.controls.iter_mut().zip(controls).for_each(|(control, value)| control.default = value);
    let mut motions = Vec::new();
    for path in &arguments.motion {
        let Motion { poses, .. } = find_motion(arguments, &model, &model.dressed, Some(path))?;
        let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        motions.push(RoomMotion { name, poses });
    }
    for (name, poses) in &model.motions {
        if motions.iter().all(|motion| motion.name != *name) {
            motions.push(RoomMotion { name: name.clone(), poses: poses.clone() });
        }
    }
    if motions.is_empty() {
        bail!("the model has no motion of its own: give one or several with --motion");
    }
    let fabric = |fabric: Fabric| RoomFabric { table: fabric.table().to_vec(), name: fabric.name };
    let fabrics: Vec<RoomFabric> = named_fabrics()?.into_iter().map(fabric).collect();
    let title = title_of(&arguments.source);
    let needed = model.dressed.rig.model_name.clone();
    let body = load_model(arguments.model.as_deref())?;
    let room = DressingRoom::new(model, body, motions, &fabrics, &title).with_context(|| {
        format!("the clothes were learnt on the body model '{needed}'; give that one with --model")
    })?;
    let server = LocalServer::bind(arguments.port)?;
    let pages = DressingPages::new(&room);
    console.note("open this address in a browser; Ctrl-C ends:");
    console.result(server.address());
    server.serve(&|request| pages.answer(request))?;
    Ok(Outcome::Fine)
}
