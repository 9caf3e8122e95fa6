//! Cameras, and their automatic placement around a box.

use glam::DVec3;

/// An axis-aligned box in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Smallest corner.
    pub low: DVec3,
    /// Largest corner.
    pub high: DVec3,
}

impl Bounds {
    /// The box around all finite points; a unit box about the origin when there is none.
    pub fn around(points: impl IntoIterator<Item = DVec3>) -> Self {
        let empty = Self { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };
        let bounds = points
            .into_iter()
            .filter(|point| point.is_finite())
            .fold(empty, |b, p| Self { low: b.low.min(p), high: b.high.max(p) });
        if bounds.low.x <= bounds.high.x {
            bounds
        } else {
            Self { low: DVec3::splat(-0.5), high: DVec3::splat(0.5) }
        }
    }

    /// Centre in metres.
    pub fn center(&self) -> DVec3 {
        0.5 * (self.low + self.high)
    }

    fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|i| {
            let pick = |bit: usize, low: f64, high: f64| if i >> bit & 1 == 0 { low } else { high };
            DVec3::new(
                pick(0, self.low.x, self.high.x),
                pick(1, self.low.y, self.high.y),
                pick(2, self.low.z, self.high.z),
            )
        })
    }
}

/// How space is projected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Projection {
    /// Parallel rays; the picture shows this many metres from top to bottom.
    Orthographic {
        /// Metres from the top to the bottom of the picture.
        visible_height: f64,
    },
    /// Rays through the eye.
    Perspective {
        /// Angle in radians between the top and the bottom of the picture.
        vertical_angle: f64,
    },
}

/// From where automatic framing looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Turn in radians about the up direction: 0 sees the front, π/2 the person's left side.
    pub yaw: f64,
    /// Height angle in radians: positive looks down.
    pub pitch: f64,
    /// Up direction.
    pub up: DVec3,
    /// Direction that the person faces at yaw 0.
    pub front: DVec3,
    /// Angle in radians between top and bottom of the picture; zero for parallel rays.
    pub vertical_angle: f64,
}

impl View {
    /// A slight perspective view in model space (y up, front +z) at angles in degrees.
    pub fn from_degrees(yaw: f64, pitch: f64) -> Self {
        let vertical_angle = 25f64.to_radians();
        Self {
            yaw: yaw.to_radians(),
            pitch: pitch.to_radians(),
            up: DVec3::Y,
            front: DVec3::Z,
            vertical_angle,
        }
    }

    /// The same view with parallel rays.
    pub fn orthographic(self) -> Self {
        Self { vertical_angle: 0.0, ..self }
    }
}

/// A camera that looks from `eye` to `target`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Position in metres.
    pub eye: DVec3,
    /// Point in metres that is in the middle of the picture.
    pub target: DVec3,
    /// Direction that points up in the picture.
    pub up: DVec3,
    /// Projection.
    pub projection: Projection,
}

/// Share of the picture that automatic framing leaves free around the box.
const MARGIN: f64 = 0.04;

impl Camera {
    /// The camera of a view that just sees the whole box in a picture of this width/height ratio.
    pub fn framing(bounds: Bounds, view: View, aspect: f64) -> Self {
        Self::framing_points(&bounds.corners(), view, aspect)
    }

    /// The camera of a view that just sees all finite points in a picture of this width/height ratio.
    pub fn framing_points(points: &[DVec3], view: View, aspect: f64) -> Self {
        let up = view.up.normalize_or(DVec3::Y);
        let front = view.front.reject_from_normalized(up).normalize_or(up.any_orthonormal_vector());
        let side = up.cross(front);
        let around = front * view.yaw.cos() + side * view.yaw.sin();
        let backwards = around * view.pitch.cos() + up * view.pitch.sin();
        let any_projection = Projection::Orthographic { visible_height: 1.0 };
        let placed = Self { eye: backwards, target: DVec3::ZERO, up, projection: any_projection };
        let axes = placed.axes();
        // The middle of what is seen along each direction of the picture, not of the box in space.
        let finite = points.iter().filter(|point| point.is_finite());
        let seen = Bounds::around(finite.clone().map(|point| DVec3::from(axes.map(|axis| axis.dot(*point)))));
        let [right, upwards, toward_eye] = axes;
        let target = seen.center().x * right + seen.center().y * upwards + seen.center().z * toward_eye;
        let offsets = finite.map(|point| axes.map(|axis| axis.dot(*point - target)));
        let room = 1.0 - 2.0 * MARGIN;
        if view.vertical_angle <= 0.0 {
            let needed = offsets.map(|[x, y, _]| (y.abs() * 2.0).max(x.abs() * 2.0 / aspect));
            let visible_height = needed.fold(1e-6, f64::max) / room;
            let eye = target + toward_eye * (seen.high.z - seen.low.z + 1.0);
            return Self { eye, target, up, projection: Projection::Orthographic { visible_height } };
        }
        let half = (0.5 * view.vertical_angle).tan() * room;
        // A point at depth z towards the eye fits when the eye is at least this far from the target.
        let needed = offsets.map(|[x, y, z]| z + (y.abs() / half).max(x.abs() / (half * aspect)));
        let distance = needed.fold(1e-3, f64::max);
        let projection = Projection::Perspective { vertical_angle: view.vertical_angle };
        Self { eye: target + toward_eye * distance, target, up, projection }
    }

    /// Unit vectors to the right, up and backwards (towards the eye) in space.
    pub(crate) fn axes(&self) -> [DVec3; 3] {
        let backwards = (self.eye - self.target).normalize_or(DVec3::Z);
        let right = self.up.cross(backwards).normalize_or(backwards.any_orthonormal_vector());
        [right, backwards.cross(right), backwards]
    }
}

/// A camera made ready for a picture size: space to pixels and back.
pub(crate) struct Projector {
    eye: DVec3,
    axes: [DVec3; 3],
    /// Pixels for a metre (parallel rays) or for a metre at one metre of distance (perspective).
    scale: f64,
    is_perspective: bool,
    center: [f64; 2],
}

/// Nearest distance in metres that is drawn.
const NEAR: f64 = 1e-3;

impl Projector {
    pub(crate) fn new(camera: &Camera, width: usize, height: usize) -> Self {
        let (scale, is_perspective) = match camera.projection {
            Projection::Orthographic { visible_height } => (height as f64 / visible_height.max(1e-9), false),
            Projection::Perspective { vertical_angle } => {
                let half = (0.5 * vertical_angle.clamp(1e-3, 3.0)).tan();
                (0.5 * height as f64 / half, true)
            }
        };
        let center = [0.5 * width as f64, 0.5 * height as f64];
        Self { eye: camera.eye, axes: camera.axes(), scale, is_perspective, center }
    }

    /// Column, row (pixel corners are whole numbers) and distance along the view of a point; NaN when it cannot be seen.
    pub(crate) fn project(&self, point: DVec3) -> [f64; 3] {
        let offset = point - self.eye;
        let distance = -self.axes[2].dot(offset);
        if distance.is_nan() || distance < NEAR {
            return [f64::NAN; 3];
        }
        let scale = if self.is_perspective { self.scale / distance } else { self.scale };
        let column = self.center[0] + scale * self.axes[0].dot(offset);
        [column, self.center[1] - scale * self.axes[1].dot(offset), distance]
    }

    pub(crate) fn is_perspective(&self) -> bool {
        self.is_perspective
    }

    pub(crate) fn axes(&self) -> [DVec3; 3] {
        self.axes
    }

    /// Origin and unit direction of the ray through a place of the picture.
    pub(crate) fn ray(&self, column: f64, row: f64) -> (DVec3, DVec3) {
        let right = self.axes[0] * ((column - self.center[0]) / self.scale);
        let up = self.axes[1] * ((self.center[1] - row) / self.scale);
        if self.is_perspective {
            (self.eye, (right + up - self.axes[2]).normalize())
        } else {
            (self.eye + right + up, -self.axes[2])
        }
    }
}
