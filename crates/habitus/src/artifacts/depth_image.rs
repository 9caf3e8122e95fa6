//! Depth images: 16-bit PNG with the intrinsics of their camera in a JSON file beside them.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why a depth image cannot be used.
#[derive(Debug, Error)]
pub enum DepthImageError {
    /// A file cannot be read.
    #[error("{}: cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// It is no 16-bit grey PNG, or its intrinsics are broken.
    #[error("{}: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// Pinhole intrinsics of a depth image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point along x, pixels; the centre of the first pixel is 0.5.
    pub cx: f64,
    /// Principal point along y, pixels.
    pub cy: f64,
    /// Metres in one unit of the image.
    pub depth_scale: f64,
}

/// Depths along the viewing axis, row by row; zero where nothing is seen.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthImage {
    /// How pixels become points.
    pub intrinsics: Intrinsics,
    /// One depth a pixel, in units of the image.
    pub depths: Vec<u16>,
}

impl DepthImage {
    /// Reads a PNG and its intrinsics.
    pub fn read(image: &Path, intrinsics: &Path) -> Result<Self, DepthImageError> {
        let malformed =
            |path: &Path, reason: String| DepthImageError::Malformed { path: path.to_path_buf(), reason };
        let read = |path: &Path| {
            std::fs::read(path)
                .map_err(|source| DepthImageError::Unreadable { path: path.to_path_buf(), source })
        };
        let camera: Intrinsics = serde_json::from_slice(&read(intrinsics)?)
            .map_err(|error| malformed(intrinsics, format!("is no intrinsics file ({error})")))?;
        let numbers = [camera.fx, camera.fy, camera.depth_scale];
        if numbers.iter().any(|value| !(value.is_finite() && *value > 0.0)) {
            return Err(malformed(intrinsics, "focal lengths and depth_scale must be positive".into()));
        }
        let bytes = read(image)?;
        let (width, height, depths) = decode(&bytes).map_err(|reason| malformed(image, reason))?;
        if (width, height) != (camera.width, camera.height) {
            let reason = format!(
                "has {width} × {height} pixels, its intrinsics are for {} × {}",
                camera.width, camera.height
            );
            return Err(malformed(image, reason));
        }
        Ok(Self { intrinsics: camera, depths })
    }

    /// The point of a pixel, if anything is seen there: the camera at the origin, x to the right, y up, looking along −z;
    /// metres.
    pub fn point(&self, column: usize, row: usize) -> Option<DVec3> {
        let camera = &self.intrinsics;
        let depth = self.depths[row * camera.width + column];
        (depth > 0).then(|| {
            let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
            DVec3::new((x - camera.cx) / camera.fx, -(y - camera.cy) / camera.fy, -1.0)
                * (f64::from(depth) * camera.depth_scale)
        })
    }
}

/// Width, height and values of a 16-bit grey PNG. The decoder limits what a file can make it allocate.
fn decode(bytes: &[u8]) -> Result<(usize, usize, Vec<u16>), String> {
    let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().map_err(|error| error.to_string())?;
    let info = reader.info();
    if (info.color_type, info.bit_depth) != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        return Err("is no 16-bit grey PNG: export depth in whole units, not as a coloured picture".into());
    }
    let (width, height) = (info.width as usize, info.height as usize);
    let size = reader.output_buffer_size().ok_or("is too large")?;
    let mut buffer = vec![0; size];
    reader.next_frame(&mut buffer).map_err(|error| error.to_string())?;
    let values = buffer.as_chunks::<2>().0.iter().map(|pair| u16::from_be_bytes(*pair)).take(width * height);
    Ok((width, height, values.collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png_of(depths: &[u16], width: u32, depth: png::BitDepth) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, depths.len() as u32 / width);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(depth);
        let data: Vec<u8> = match depth {
            png::BitDepth::Sixteen => depths.iter().flat_map(|value| value.to_be_bytes()).collect(),
            _ => depths.iter().map(|value| *value as u8).collect(),
        };
        encoder.write_header().and_then(|mut writer| writer.write_image_data(&data)).expect("encodes");
        bytes
    }

    #[test]
    fn pixels_become_points_and_wrong_files_are_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let (image, camera) = (folder.path().join("front.png"), folder.path().join("intrinsics.json"));
        let text = r#"{"width":3,"height":2,"fx":100.0,"fy":100.0,"cx":1.5,"cy":1.0,"depth_scale":0.001}"#;
        std::fs::write(&camera, text).expect("writes");
        std::fs::write(&image, png_of(&[0, 2000, 0, 0, 0, 1000], 3, png::BitDepth::Sixteen)).expect("writes");
        let depth = DepthImage::read(&image, &camera).expect("reads");
        assert_eq!(depth.point(0, 0), None);
        assert!(depth.point(1, 0).expect("is seen").distance(DVec3::new(0.0, 0.01, -2.0)) < 1e-12);
        assert!(depth.point(2, 1).expect("is seen").distance(DVec3::new(0.01, -0.005, -1.0)) < 1e-12);
        std::fs::write(&image, png_of(&[1; 6], 3, png::BitDepth::Eight)).expect("writes");
        let message = DepthImage::read(&image, &camera).expect_err("is refused").to_string();
        assert!(message.contains("front.png") && message.contains("16-bit"), "{message}");
        std::fs::write(&image, png_of(&[1; 6], 2, png::BitDepth::Sixteen)).expect("writes");
        assert!(DepthImage::read(&image, &camera).expect_err("is refused").to_string().contains("2 × 3"));
        std::fs::write(&image, &png_of(&[1; 6], 3, png::BitDepth::Sixteen)[..40]).expect("writes");
        assert!(DepthImage::read(&image, &camera).is_err());
        std::fs::write(&camera, text.replace("100.0", "-1.0")).expect("writes");
        assert!(DepthImage::read(&image, &camera).expect_err("is refused").to_string().contains("positive"));
    }
}
