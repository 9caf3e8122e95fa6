//! Whether the parts of the 3D view belong together; found out before anything is written.

use super::{BodyView, FrameView, ModelView, ReportData, ReportError};

/// Fails on the first contradiction and names its place.
pub(crate) fn check(data: &ReportData) -> Result<(), ReportError> {
    let Some(model) = &data.model else { return Ok(()) };
    check_body(&model.body)?;
    for view in &model.frames {
        within("3D view: frame number", view.frame, data.frames.len())?;
        check_frame(view, model, &data.frames[view.frame].name)?;
    }
    for row in &data.measurements {
        if row.curve.as_ref().is_some_and(|curve| curve.points.iter().any(|point| !point.is_finite())) {
            return Err(ReportError::NotFinite { place: format!("curve of measurement {}", row.name) });
        }
    }
    Ok(())
}

fn check_body(body: &BodyView) -> Result<(), ReportError> {
    let vertex_count = body.rest_vertices.len();
    same_count("body: skin bones", vertex_count, body.skin_bones.len())?;
    same_count("body: skin weights", vertex_count, body.skin_weights.len())?;
    same_count("body: parents", body.joints.len(), body.parents.len())?;
    for vertex in body.faces.iter().flatten() {
        within("body: vertex of a face", *vertex as usize, vertex_count)?;
    }
    for bone in body.skin_bones.iter().flatten() {
        within("body: skin bone", *bone as usize, body.joints.len())?;
    }
    for parent in body.parents.iter().flatten() {
        within("body: parent of a bone", *parent, body.joints.len())?;
    }
    let is_finite = body.rest_vertices.iter().chain(&body.joints).all(|point| point.is_finite())
        && body.skin_weights.iter().flatten().all(|weight| weight.is_finite());
    if is_finite { Ok(()) } else { Err(ReportError::NotFinite { place: "body".into() }) }
}

fn check_frame(view: &FrameView, model: &ModelView, name: &str) -> Result<(), ReportError> {
    let place = |what: &str| format!("frame {name}: {what}");
    same_count(&place("bone transforms"), model.body.joints.len(), view.posed_from_rest.len())?;
    if !view.clearance_mm.is_empty() {
        same_count(&place("clearances"), model.body.rest_vertices.len(), view.clearance_mm.len())?;
    }
    for vertex in view.capture.faces.iter().flatten() {
        within(&place("vertex of a face of the capture"), *vertex as usize, view.capture.positions.len())?;
    }
    let is_finite = view.posed_from_rest.iter().all(|transform| transform.is_finite())
        && view.landmarks.iter().all(|landmark| landmark.position.is_finite());
    if is_finite {
        Ok(())
    } else {
        Err(ReportError::NotFinite { place: place("bone transforms or landmarks") })
    }
}

fn same_count(place: &str, expected: usize, found: usize) -> Result<(), ReportError> {
    if expected == found {
        Ok(())
    } else {
        Err(ReportError::Count { place: place.to_owned(), expected, found })
    }
}

fn within(place: &str, found: usize, limit: usize) -> Result<(), ReportError> {
    if found < limit {
        Ok(())
    } else {
        Err(ReportError::OutOfRange { place: place.to_owned(), found, limit })
    }
}
