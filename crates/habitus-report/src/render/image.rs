//! A picture of 8-bit screen values, its captions and its PNG file.

use std::io::{BufWriter, Error};
use std::path::Path;

use super::RenderError;
use super::font::{GLYPH_HEIGHT, GLYPH_WIDTH, glyph};

/// Largest side of a picture in pixels: keeps a mistyped size from taking all memory.
const SIDE_LIMIT: usize = 16_384;

/// A picture: rows from top to bottom, three screen values (sRGB) a pixel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

impl Image {
    /// A picture of one colour.
    ///
    /// # Errors
    /// When a side is zero or above the limit.
    pub fn filled(width: usize, height: usize, color: [u8; 3]) -> Result<Self, RenderError> {
        if width == 0 || height == 0 || width > SIDE_LIMIT || height > SIDE_LIMIT {
            return Err(RenderError::Size { width, height, limit: SIDE_LIMIT });
        }
        Ok(Self { width, height, pixels: vec![color; width * height] })
    }

    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row from the top.
    pub fn pixels(&self) -> &[[u8; 3]] {
        &self.pixels
    }

    pub(crate) fn pixels_mut(&mut self) -> &mut [[u8; 3]] {
        &mut self.pixels
    }

    /// The pixel of column `x` and row `y`, if it exists.
    pub fn pixel(&self, x: usize, y: usize) -> Option<[u8; 3]> {
        (x < self.width && y < self.height).then(|| self.pixels[y * self.width + x])
    }

    /// Sets a pixel; outside the picture nothing happens.
    pub fn set_pixel(&mut self, x: usize, y: usize, color: [u8; 3]) {
        if x < self.width && y < self.height {
            self.pixels[y * self.width + x] = color;
        }
    }

    /// Copies another picture with its top left corner at (`left`, `top`), cut at the border.
    pub fn paste(&mut self, other: &Self, left: usize, top: usize) {
        let columns = other.width.min(self.width.saturating_sub(left));
        for y in 0..other.height.min(self.height.saturating_sub(top)) {
            let from = y * other.width;
            let to = (top + y) * self.width + left;
            self.pixels[to..to + columns].copy_from_slice(&other.pixels[from..from + columns]);
        }
    }

    /// Writes a line of ASCII text with its top left corner at (`left`, `top`); letters are `scale` times 5 × 7 pixels.
    pub fn draw_text(&mut self, left: usize, top: usize, text: &str, scale: usize, color: [u8; 3]) {
        for (number, character) in text.chars().enumerate() {
            let rows = glyph(character);
            let glyph_left = left + number * (GLYPH_WIDTH + 1) * scale;
            for y in 0..GLYPH_HEIGHT * scale {
                for x in 0..GLYPH_WIDTH * scale {
                    if rows[y / scale] >> (GLYPH_WIDTH - 1 - x / scale) & 1 == 1 {
                        self.set_pixel(glyph_left + x, top + y, color);
                    }
                }
            }
        }
    }

    /// Width in pixels of a line of text at a scale.
    pub fn text_width(text: &str, scale: usize) -> usize {
        (text.chars().count() * (GLYPH_WIDTH + 1)).saturating_sub(1) * scale
    }

    /// The picture as the bytes of a PNG file.
    ///
    /// # Errors
    /// When the encoder fails.
    pub fn to_png(&self) -> Result<Vec<u8>, RenderError> {
        let mut bytes = Vec::new();
        self.encode(&mut bytes).map_err(|source| RenderError::Write { path: "(memory)".into(), source })?;
        Ok(bytes)
    }

    /// Writes the picture as a PNG file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save_png(&self, path: &Path) -> Result<(), RenderError> {
        let write = || self.encode(BufWriter::new(std::fs::File::create(path)?));
        write().map_err(|source| RenderError::Write { path: path.to_owned(), source })
    }

    fn encode(&self, target: impl std::io::Write) -> Result<(), Error> {
        let mut encoder = png::Encoder::new(target, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header().map_err(Error::other)?;
        writer.write_image_data(self.pixels.as_flattened()).map_err(Error::other)?;
        writer.finish().map_err(Error::other)
    }
}
